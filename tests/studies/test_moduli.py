"""Moduli of plates by their peaks, with air and a sensor beside them."""

from dataclasses import replace

import pytest
import torch

from torchplate.cli.config.build import load_run
from torchplate.studies import moduli as study
from torchplate.studies.moduli import PUBLISHED, VARIANTS, Variant, config, moduli, paired


@pytest.fixture(autouse=True)
def folders(monkeypatch, request, tmp_path):
    monkeypatch.setattr(study, "CONFIGS", request.config.rootpath / "configs" / "real")
    monkeypatch.setattr(study, "OUT", tmp_path)


def test_peaks_are_paired_in_their_order_with_the_modes_that_lie_nearest():
    model = [50.0, 81.0, 120.0, 122.0, 170.0, 240.0]
    # One by one 120 and 121 would both take the mode at 120.
    assert paired(model, [82.0, 120.0, 121.0, 230.0]) == (1, 2, 3, 5)
    assert paired(model, model) == tuple(range(6))


def test_the_variants_differ_by_what_they_say(tmp_path):
    sensor = {}
    for variant in VARIANTS:
        path = tmp_path / f"{variant.name}.yaml"
        path.write_text(study.dump(config("3R", variant, [60.5, 71.0], [4, 5])))
        effects = load_run(path).config.effects
        assert ("air" in effects) == (variant.air > 0)
        sensor[variant.name] = effects.get("sensor")
    assert sensor["plate"] is None
    # 2 cm off both sides of 579.4 × 217.6 mm.
    assert sensor["sensor_3"]["x"] == pytest.approx(1 - 20 / 579.4, abs=1e-5)
    assert sensor["sensor_3"]["mass"] == 3e-3


@pytest.mark.check
def test_moduli_of_a_plate_in_air_are_found_from_its_peaks(monkeypatch):
    """Its own truth: the modes of the published moduli in air; a vacuum makes them lower."""
    at, numbers = PUBLISHED["1L"], range(4, 13)
    case = next(one for one in study.CASES if one.name == "spruce_1L")
    hertz = natural(at, numbers)
    monkeypatch.setattr(study, "CASES", [replace(case, peaks=hertz)])
    found, vacuum = (moduli("1L", Variant("truth", "", air)) for air in (1.2, 0.0))
    assert found.modes == tuple(numbers)
    middle = found.interval[:, 1]
    torch.testing.assert_close(middle, torch.tensor(at, dtype=torch.float64), rtol=0.01, atol=0.0)
    assert bool((vacuum.interval[:, 1] < middle).all())
    assert vacuum.off > found.off


def natural(moduli_in_gpa, numbers):
    variant = Variant("truth", "", 1.2)
    raw = config("1L", variant, [50.0 + k for k in numbers], list(numbers))
    e_x, e_y, g = (1e9 * one for one in moduli_in_gpa)
    e = (e_x * e_y) ** 0.5
    raw["effects"]["plate"]["youngs_modulus"] = e
    raw["effects"]["grain"] |= {"young_ratio": e_y / e_x, "shear_factor": 2.2 * g / e}
    path = study.OUT / "truth.yaml"
    path.write_text(study.dump(raw))
    model = load_run(path).model()
    found = model.natural_frequencies(torch.zeros(0, dtype=torch.float64), max(numbers))
    return tuple(float(found[k - 1]) for k in numbers)
