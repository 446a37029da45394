"""The measured free strip, end to end: 20 FRFs whose level and material nobody wrote down."""

import math
from io import StringIO
from pathlib import Path

import pytest
import torch
from rich.console import Console

from torchplate.cli.config.build import load_model
from torchplate.cli.verbs.run import run
from torchplate.model import SparseModel

ROOT = Path(__file__).parents[2]
FILE = ROOT.parent / "shared" / "data" / "free_strip.uff"
BENDING = (27.0, 53.0, 88.0, 131.5, 184.0, 245.5)
TORSION = 45.0

pytestmark = [
    pytest.mark.check,
    pytest.mark.skipif(not FILE.is_file(), reason=f"the measurement is not part of the project: {FILE}"),
]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """`configs/free_strip.yaml` with a quarter of its generations."""
    quicker = ["search.n_generation=20", "log.n_figure=0"]
    out = tmp_path_factory.mktemp("free_strip") / "run"
    return run(ROOT / "configs" / "free_strip.yaml", out, quicker, console=Console(file=StringIO()))


def test_the_wave_speed_of_the_strip_is_found(found):
    # ρ = 1000 kg/m³ and h = 0.01 m are set; only their combination with E shows.
    speed = 0.01 * math.sqrt(found.result["parameters"]["plate.youngs_modulus"]["value"] / 1000.0)
    assert speed == pytest.approx(14.85, rel=0.01)


def test_its_bending_and_torsion_frequencies_are_those_measured(found):
    model = load_model(found.folder / "config.yaml")
    theta = torch.tensor([e["value"] for e in found.result["parameters"].values()], dtype=torch.float64)
    modes = SparseModel(model, theta).modes(16)
    # Deflections of the left and the right edge at ten places: equal in bending, opposite in torsion.
    along = torch.linspace(0.03, 0.97, 10, dtype=torch.float64)
    left, right = (
        model.assembly.rows(model.mesh.deflection_at(torch.stack([along, torch.full_like(along, y)], -1))) @ modes.shape
        for y in (0.0, 1.0)
    )
    even = (left + right).norm(dim=0) > (left - right).norm(dim=0)
    # The measured band begins at 25 Hz, above the first bending mode.
    in_band = modes.frequency > 25.0
    bending = modes.frequency[even & in_band][: len(BENDING)].tolist()
    torsion = modes.frequency[~even & in_band][0].item()
    assert bending == pytest.approx(BENDING, rel=0.01)
    assert torsion == pytest.approx(TORSION, rel=0.01)
    listed = torch.tensor(found.result["natural_frequencies_hz"], dtype=torch.float64)
    for hertz in (*bending, torsion):
        assert float((listed / hertz - 1).abs().min()) < 1e-6


def test_the_fitted_level_is_reported(found):
    assert found.result["gain"] > 0
    assert "fitted" in (found.folder / "report.md").read_text()
