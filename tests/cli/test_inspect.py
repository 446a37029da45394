"""The report says what the file holds and what looks wrong, and the figure is written where it says."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import torch
from rich.console import Console

from torchplate.cli.inspect import inspect
from torchplate.measurement import SI_UNIT, Channel, Measurement, MeasurementError, write_uff

PNG = b"\x89PNG\r\n\x1a\n"


def three_channels(coherence: bool = True) -> Measurement:
    """One mode at 61 Hz, seen by two sensors and two forces; sensor 5 carries the wrong sign."""
    frequency = torch.arange(30.0, 121.0, 0.5, dtype=torch.float64)
    omega = 2 * torch.pi * frequency
    mode = -(omega**2) / ((2 * torch.pi * 61.0) ** 2 * (1 + 0.03j) - omega**2)
    frf = mode[:, None, None] * torch.tensor([[0.9, 0.4], [-0.4, -0.7]], dtype=torch.float64)
    return Measurement(
        frequency=frequency,
        frf=frf,
        measured=torch.ones(2, 2, dtype=torch.bool),
        response=(Channel(2, "w", (0.1, 0.0, 0.0)), Channel(5, "w", (0.3, 0.2, 0.0))),
        reference=(Channel(2, "w", (0.1, 0.0, 0.0)), Channel(5, "w", (0.3, 0.2, 0.0))),
        kind="accelerance",
        unit=SI_UNIT["accelerance"],
        coherence=torch.full_like(frf.real, 0.93) if coherence else None,
    )


def report(measurement: Measurement, folder, name="plate.uff") -> tuple[str, bytes]:
    path = folder / name
    write_uff(measurement, path) if name.endswith("uff") else measurement.to_npz(path)
    screen = StringIO()
    figure = inspect(path, folder / "seen", Console(file=screen, width=200))
    assert figure == folder / "seen" / "plate.png"
    return screen.getvalue(), figure.read_bytes()


def test_the_report_names_what_is_in_the_file_and_what_looks_wrong(tmp_path):
    text, figure = report(three_channels(), tmp_path)
    for words in (
        "4 of 2 × 2",
        "2w 5w",
        "accelerance, m/(N s²)",
        "30 to 120.5 Hz, step 0.5 Hz, 182 lines",
        "2 of 2 nodes, x 0.1 to 0.3 m, y 0 to 0.2 m, z 0 m",
        "2w/2w (Re mobility < 0 on 0% of the lines",
        "5w/5w (Re mobility < 0 on 100% of the lines",
        "2w/5w against 5w/2w: 200.0% apart",
        "mean 0.9300",
        "61 Hz",
        "5w/5w: wrong sign?",
        "rms level [m/(N s²)]",
        str(tmp_path / "seen" / "plate.png"),
    ):
        assert words in text
    assert figure.startswith(PNG)


@pytest.mark.parametrize("name", ["plate.uff", "plate.npz"])
def test_a_measurement_without_coherence_or_places_is_reported_as_such(name, tmp_path):
    whole = three_channels(coherence=False)
    bare = replace(whole, response=(Channel(2), Channel(5)), reference=(Channel(2), Channel(5)))
    text, figure = report(bare, tmp_path, name)
    assert "none in the file" in text
    assert "matched to the plate by node number" in text
    assert figure.startswith(PNG)


@pytest.mark.parametrize("n", [1, 7, 70])
def test_one_and_many_channels_are_drawn(n, tmp_path):
    one = three_channels()
    gains = torch.linspace(0.5, 2.0, n, dtype=torch.float64)
    many = replace(
        one,
        frf=one.frf[:, :1, :1] * gains,
        coherence=None,
        measured=torch.ones(1, n, dtype=torch.bool),
        response=(Channel(2),),
        reference=tuple(Channel(i + 1) for i in range(n)),
    )
    text, figure = report(many, tmp_path)
    assert f"{n} of 1 × {n}" in text
    assert figure.startswith(PNG)
    # Wide enough to be read, and not an empty canvas: its width is 11 in at 150 dots.
    assert np.frombuffer(figure[16:20], dtype=">u4")[0] == 1650
    assert len(figure) > 20_000


def test_a_dead_channel_can_be_drawn(tmp_path):
    whole = three_channels()
    frf = whole.frf.clone()
    frf[:, 1, 0] = 0
    text, _ = report(replace(whole, frf=frf), tmp_path)
    assert "5w/2w: dead" in text


def test_the_default_folder_is_runs_inspect(tmp_path, monkeypatch):
    write_uff(three_channels(), tmp_path / "strip.uff")
    monkeypatch.chdir(tmp_path)
    figure = inspect(tmp_path / "strip.uff", console=Console(file=StringIO()))
    assert (tmp_path / figure).resolve() == (tmp_path / "runs" / "inspect" / "strip.png").resolve()
    assert figure.is_file()


def test_a_file_that_cannot_be_used_raises_the_users_error(tmp_path):
    path = tmp_path / "broken.uff"
    path.write_text("nothing")
    with pytest.raises(MeasurementError, match=r"broken\.uff"):
        inspect(path, tmp_path, Console(file=StringIO()))
