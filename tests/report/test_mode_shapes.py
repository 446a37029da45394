"""Mode shapes are the model's, and beside them stand the shapes that were measured at their resonances."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchplate.measurement import Channel, Measurement
from torchplate.model import DENSE, SparseModel
from torchplate.report.figures.measured_shapes import N_PLACE, measured_shapes, roved
from torchplate.report.figures.mode_shapes import N_GRID, N_MODE, composite, mode_shapes, modes_caption, modes_of, told

_spec = importlib.util.spec_from_file_location("samples", Path(__file__).with_name("samples.py"))
assert _spec is not None
assert _spec.loader is not None
samples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(samples)
EVERY = tuple(range(1, 13))


def modes(response=(4, 7), reference=(1, 6), n_line=12):
    found = samples.diagnosis(response, reference, n_line=n_line)
    return found.model, found.overlay.measured, modes_of(found.model, found.model.known[:0], found.overlay.measured)


def test_the_modes_are_those_of_the_model_in_the_band():
    model, _, found = modes()
    solved = SparseModel(model, model.known[:0]).modes(20, 330.0, dense=model.assembly.size <= DENSE)
    hertz = solved.frequency
    band = [index + 1 for index in range(len(hertz)) if 6.0 <= float(hertz[index]) <= 330.0]
    assert [mode.number for mode in found] == band[:N_MODE]
    for mode in found:
        assert mode.frequency == pytest.approx(float(hertz[mode.number - 1]), rel=1e-9)
        # At the corners (0, 0) and (Lx, 0), nodes 1 and 4, the shape is the eigenvector's.
        rows = model.mesh.deflection_at(model.mesh.places([1, 4]))[..., model.assembly.free]
        one, other = (rows @ solved.shape[:, mode.number - 1]).tolist()
        assert float(mode.field[0, 0]) * other == pytest.approx(float(mode.field[0, -1]) * one, abs=1e-9)
        assert mode.field.shape == (N_GRID, N_GRID)
        assert float(mode.field.abs().max()) == float(mode.field.max()) == 1.0
        assert mode.measured is None


def test_without_a_band_the_lowest_that_bend_the_plate_are_drawn():
    model, _, _ = modes()
    found = modes_of(model, model.known[:0], None)
    assert len(found) == N_MODE
    assert found[0].frequency > 0
    assert "measured at" not in told(found[0], False)


@pytest.mark.parametrize(("response", "reference"), [(EVERY, (1, 6)), ((1, 6), EVERY)])
def test_a_shape_that_was_measured_stands_beside_its_mode(response, reference):
    _, _, found = modes(response, reference, n_line=400)
    beside = [mode for mode in found if mode.measured is not None]
    # Every mode but those that hide in the flank of another.
    assert len(beside) > 0.6 * len(found)
    for mode in beside:
        # The lines stand 0.8 Hz apart, and the exact FRFs have noise of a hundredth.
        assert mode.measured.frequency == pytest.approx(mode.frequency, rel=0.03, abs=1.0)
        assert mode.measured.mac > 0.95
        # Of one sign with the model's: the largest of the model is positive.
        nearest = (mode.measured.place * (N_GRID - 1)).round().long()
        drawn = torch.stack([mode.field[y, x] for x, y in nearest.tolist()])
        assert float(drawn @ mode.measured.value) > 0
    assert len({mode.measured.frequency for mode in beside}) == len(beside)
    assert f"MAC {beside[0].measured.mac:.2f}" in told(beside[0], True)
    assert "dots: the channels" in modes_caption(found)


def test_the_mac_is_that_of_both_shapes_at_the_channels():
    frequency = torch.linspace(1.0, 100.0, 100, dtype=torch.float64)
    generator = torch.Generator().manual_seed(5)
    true, other = torch.randn(2, 10, generator=generator, dtype=torch.float64)
    place = torch.rand(10, 2, generator=generator, dtype=torch.float64)
    resonance = 1 / (40.0**2 - frequency**2 + 1j * 40.0)
    # A phase of its own, as a mobility has.
    frf = (1j * resonance[:, None, None] * true[:, None] * torch.tensor([0.7, -2.0])).to(torch.complex128)
    seen = roved(_measured(frequency, frf), place, place[:2])
    assert seen is not None
    model = torch.stack([other, -(true + 0.3 * other)], dim=1)
    found = measured_shapes(frequency, seen, torch.tensor([42.0, 41.0], dtype=torch.float64), model)
    assert set(found) == {1}
    assert found[1].frequency == 40.0
    wanted = float((true @ model[:, 1]) ** 2 / ((true @ true) * (model[:, 1] @ model[:, 1])))
    assert found[1].mac == pytest.approx(wanted, rel=1e-9)
    assert float(found[1].value @ model[:, 1]) > 0
    # Beyond 8 % it is the resonance of another mode.
    assert not measured_shapes(frequency, seen, torch.tensor([44.0, 36.0], dtype=torch.float64), model)


def _measured(frequency, frf):
    ends = [tuple(Channel(node + 1) for node in range(size)) for size in frf.shape[1:]]
    kept = torch.ones(frf.shape[1:], dtype=torch.bool)
    return Measurement(frequency, frf, kept, *ends, "mobility", "m/(N s)")


def test_too_few_places_or_places_on_one_line_show_no_shape():
    _, measured, _ = modes(EVERY, (1, 6))
    place = torch.rand(12, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    assert roved(measured, place, place[:2]) is not None
    line = torch.stack([torch.linspace(0, 1, 12, dtype=torch.float64), torch.full((12,), 0.3, dtype=torch.float64)], -1)
    assert roved(measured, line, place[:2]) is None
    kept = measured.measured.clone()
    kept[N_PLACE - 1 :] = False
    assert roved(replace(measured, measured=kept), place, place[:2]) is None


def test_a_channel_that_was_not_measured_everywhere_is_left_out():
    _, measured, _ = modes(EVERY, (1, 6))
    place = torch.rand(12, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    kept = measured.measured.clone()
    kept[2, :] = False
    kept[5, 1] = False
    seen = roved(replace(measured, measured=kept), place, place[:2])
    rows = [row for row in range(12) if row != 2]
    assert torch.equal(seen.place, place[rows])
    assert torch.equal(seen.frf, measured.frf[:, rows][:, :, :1])


@pytest.mark.check
def test_every_mode_has_a_panel_and_the_measured_one_is_in_it():
    _, _, found = modes(EVERY, (1, 6), n_line=200)
    panels = mode_shapes(found, samples.SIDES)
    assert len(panels) == len(found)
    for panel, mode in zip(panels, found, strict=True):
        titles = [axis.get_title() for axis in panel.draw().axes]
        assert titles[0] == f"{mode.number}: {mode.frequency:.4g} Hz"
        assert titles[1].endswith(f"MAC {mode.measured.mac:.2f}" if mode.measured else "no peak near it")
    alone = mode_shapes([mode._replace(measured=None) for mode in found], samples.SIDES)
    assert {len(panel.draw().axes) for panel in alone} == {1}
    assert alone[0].draw().get_figwidth() < panels[0].draw().get_figwidth() / 2
    assert (alone[0].small, panels[0].small) == (True, False)
    whole = composite(found, samples.SIDES)
    assert len(whole.get_axes()) == 2 * len(found)
