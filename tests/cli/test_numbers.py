"""Numbers of a config as people write them."""

import pytest

from torchplate.cli.config import read_config


@pytest.mark.parametrize("written", ["2.1e11", "2.1E+11", "2.1D11", "2.1d+11", "210000000000.0"])
def test_a_number_with_an_exponent_is_a_number(written, tmp_path):
    path = tmp_path / "plate.yaml"
    mesh = "mesh: {length_x: 0.4, length_y: 0.3, n_x: 4, n_y: 3}"
    numbers = f"youngs_modulus: {written}, poisson_ratio: 0.3, density: 7800.0, thickness: 0.003"
    path.write_text(f"{mesh}\neffects: {{plate: {{effect: plate, {numbers}}}}}\n")
    raw, _ = read_config(path)
    assert raw["effects"]["plate"]["youngs_modulus"] == 2.1e11
