"""What no value in the intervals mends is said before a search: frequencies, kind and level; what fits is not."""

import math
from dataclasses import replace

import pytest
import torch

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.measurement import SI_UNIT, Channel, Measurement, NaturalFrequencies
from torchplate.measurement.assessment.plausibility import disagreements
from torchplate.measurement.assessment.quality import runs_backwards
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

RECTANGLE, SQUARE = Mesh(0.48, 0.37, 8, 6), Mesh(0.48, 0.48, 7, 7)
TRUTH = {"sheet.youngs_modulus": 1.9e11, "wires.stiffness": 900.0, "loss.stiffness_loss_factor": 8e-3}
BOX = {
    "sheet.youngs_modulus": Searched(1.5e11, 2.6e11),
    "wires.stiffness": Searched(400.0, 2000.0),
    "loss.stiffness_loss_factor": Searched(1e-4, 5e-2, logarithmic=True),
}
RESPONSE, REFERENCE = [(0.1, 0.2), (0.9, 0.35)], [(0.0, 0.0), (0.35, 0.8), (0.7, 0.1)]


def plate(mesh: Mesh = RECTANGLE, kind: str = "accelerance", box: bool = True, **changes: object) -> PlateModel:
    known = {
        "sheet.poisson_ratio": 0.3,
        "sheet.density": 7860.0,
        "sheet.thickness": 0.0027,
        "wires.viscous_damping": 0.5,
    }
    searched = dict(BOX) if box else {}
    if not box:
        known |= TRUTH
    for name, value in changes.items():
        searched.pop(f"sheet.{name}", None)
        if isinstance(value, tuple):
            searched[f"sheet.{name}"] = Searched(*value)
        else:
            known[f"sheet.{name}"] = value
    effects = {
        "sheet": Plate(),
        "wires": SupportSpring(at=((0.1, 0.0), (0.9, 0.0), (0.1, 1.0), (0.9, 1.0))),
        "loss": HystereticDamping(),
    }
    return PlateModel(mesh, effects, known, searched, RESPONSE, REFERENCE, kind)


def measured(mesh: Mesh = RECTANGLE, kind: str = "accelerance", noise: float = 0.01, gain: float = 1.0) -> Measurement:
    """The true plate's FRFs from 5 to 400 Hz, with noise on every line."""
    frequency = torch.linspace(5.0, 400.0, 791, dtype=torch.float64)
    frf = plate(mesh, kind, box=False).frf(torch.zeros(0, dtype=torch.float64), frequency)
    generator = torch.Generator().manual_seed(3)
    scatter = torch.randn(*frf.shape, 2, generator=generator, dtype=torch.float64)
    frf = gain * (frf + noise * frf.abs().median(dim=0).values * torch.view_as_complex(scatter))
    return Measurement(
        frequency,
        frf,
        torch.ones(2, 3, dtype=torch.bool),
        tuple(Channel(node) for node in (3, 5)),
        tuple(Channel(node) for node in (1, 4, 6)),
        kind,
        SI_UNIT[kind],
    )


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.3])
@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_a_test_of_the_plate_itself_passes_without_a_word(mesh, noise):
    assert disagreements(plate(mesh), measured(mesh, noise=noise)) == ()


def test_a_plate_that_is_not_quite_the_model_passes_without_a_word():
    # 20 % in every natural frequency and a fifth of the damping: a search can say what that is.
    assert disagreements(plate(thickness=0.0033), measured()) == ()
    assert disagreements(plate(youngs_modulus=1.3e11), measured()) == ()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"thickness": 0.27}, ["no natural", "thickness in centimetres (write 0.0027)"]),
        ({"youngs_modulus": (15e7, 26e7)}, ["natural frequencies", "kilopascals (write [1.5e+11, 2.6e+11])"]),
        ({"youngs_modulus": 29e6}, ["pounds per square inch (write 1.999e+11)"]),
        ({"mesh": Mesh(48.0, 37.0, 8, 6)}, ["the sides in centimetres"]),
        ({"mesh": Mesh(18.9, 14.57, 8, 6)}, ["the sides in inches"]),
        ({"thickness": 0.00027}, ["natural frequencies", "check these in m, Pa and kg/m³"]),
    ],
)
def test_numbers_in_another_unit_leave_the_band_and_are_named(changes, words):
    (sentence,) = disagreements(plate(**changes), measured())
    assert "whatever the values in the intervals" in sentence
    assert all(word in sentence for word in words), sentence


@pytest.mark.parametrize(
    ("gain", "words"),
    [
        (1 / 9.80665, ["g that are labelled m/s²", "by 9.807"]),
        (9.80665, ["m/s² that are labelled g", "by 0.102"]),
        (1e3, ["millimetres that are labelled metres", "by 0.001"]),
        (1e-3, ["metres that are labelled millimetres", "by 1000"]),
        (40.0, ["calibration", "mass"]),
    ],
)
def test_a_level_in_another_unit_is_said_with_the_way_out(gain, words):
    (sentence,) = disagreements(plate(), measured(gain=gain))
    assert "set measurement.gain: unknown" in sentence
    assert all(word in sentence for word in words), sentence
    assert disagreements(plate(), measured(gain=gain), gain_is_unknown=True) == ()


def test_a_plate_that_is_far_too_light_shows_in_the_level_and_the_mass_is_named():
    (sentence,) = disagreements(plate(density=7.86), measured())
    assert "0.003769 kg" in sentence


def test_a_mobility_knows_no_g():
    (sentence,) = disagreements(plate(kind="mobility"), measured(kind="mobility", gain=9.80665))
    assert "labelled" not in sentence
    assert "measurement.gain: unknown" in sentence


@pytest.mark.parametrize("gain_is_unknown", [False, True])
@pytest.mark.parametrize("true", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("stated", ["receptance", "mobility", "accelerance"])
def test_a_kind_that_the_frequencies_contradict_is_named(true, stated, gain_is_unknown):
    frfs = replace(measured(kind=true), kind=stated, unit=SI_UNIT[stated])
    found = disagreements(plate(kind=stated), frfs, gain_is_unknown=gain_is_unknown)
    if true == stated:
        assert found == ()
    else:
        assert f"Set measurement.kind: {true}" in found[0]


def test_a_narrow_band_says_nothing_of_the_kind():
    frfs = measured(kind="mobility").band(200.0, 300.0)
    assert not any("measurement.kind" in text for text in disagreements(plate(), replace(frfs, kind="accelerance")))


def test_a_table_of_natural_frequencies_is_compared_mode_by_mode():
    values = plate(box=False).natural_frequencies(torch.zeros(0, dtype=torch.float64), 12).tolist()
    table = NaturalFrequencies.from_mapping({mode: values[mode - 1] for mode in (4, 5, 6, 8, 11)})
    assert disagreements(plate(), table=table) == ()
    (sentence,) = disagreements(plate(thickness=2.7e-4), table=table)
    assert sentence.startswith("The model's natural frequencies are 0.1")
    (sentence,) = disagreements(plate(thickness=0.27), table=table)
    assert "thickness in centimetres (write 0.0027)" in sentence


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"density": 2700.0}, ["effects.sheet.density", "(as of steel, stainless steel"]),
        ({"youngs_modulus": (5.6e10, 8.4e10)}, ["effects.sheet.youngs_modulus", "(as of steel, stainless steel"]),
        ({"thickness": 0.0054}, ["effects.sheet.thickness"]),
    ],
)
@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_a_number_of_another_plate_is_named_beside_a_table(mesh, changes, words):
    """All modes are off by one factor, which no other numbers of the modes explain."""
    values = plate(mesh, box=False).natural_frequencies(torch.zeros(0, dtype=torch.float64), 14).tolist()
    table = NaturalFrequencies.from_mapping({mode: values[mode - 1] for mode in range(4, 15)})
    assert disagreements(plate(mesh), table=table) == ()
    (sentence,) = disagreements(plate(mesh, **changes), table=table)
    assert "times the measured ones, whatever the values in the intervals" in sentence
    assert all(word in sentence for word in words), sentence


def test_many_searched_parameters_cost_no_more_than_their_number():
    from torchplate.measurement.assessment.plausibility import _members

    assert len(_members(3, 4)) == 1 + 2**3
    assert len(_members(11, 4)) == 1 + 2 * 11 + 2
    assert bool(((_members(11, 4) >= 0) & (_members(11, 4) <= 1)).all())


@pytest.mark.parametrize(
    ("edges", "first"),
    [({"x0": "clamped"}, 0), ({"x0": "simply_supported"}, 1), ({"x0": "simply_supported", "x1": "free"}, 1), ({}, 3)],
)
def test_rigid_body_modes_are_those_that_the_edges_leave(edges, first):
    from torchplate.measurement.assessment.plausibility import _n_rigid

    mesh = Mesh(0.5, 0.3, 4, 3, edges=edges)
    model = plate(mesh, box=False)
    assert _n_rigid(model) == first
    bare = PlateModel(
        mesh,
        {"p": Plate()},
        {
            f"p.{name}": value
            for name, value in (
                ("youngs_modulus", 2e11),
                ("poisson_ratio", 0.3),
                ("density", 7860.0),
                ("thickness", 0.003),
            )
        },
    )
    frequency = bare.natural_frequencies(torch.zeros(0, dtype=torch.float64), 5)
    # Rounding leaves a rigid-body mode below a thousandth of the first bending mode.
    assert int((frequency < 1e-2 * frequency[-1]).sum()) == first


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_frfs_that_are_complex_conjugate_are_said_to_run_backwards(noise):
    right = measured(noise=noise)
    (told,) = disagreements(plate(), replace(right, frf=right.frf.conj().resolve_conj()))
    assert told.startswith("Time runs backwards in the FRFs")
    assert "complex conjugate" in told


@pytest.mark.parametrize("n", [32, 400])
def test_noise_alone_and_peaks_narrower_than_the_lines_run_neither_way(n):
    right = measured().band(5.0, 5.0 + 0.5 * (n - 1)) if n < 400 else measured().every(40)
    for seed in range(40):
        scatter = torch.randn(*right.frf.shape, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        assert not runs_backwards(replace(right, frf=torch.view_as_complex(scatter)))
    assert not runs_backwards(right)


def test_a_delay_and_a_turned_sensor_do_not_turn_time():
    right = measured()
    phase = torch.exp(-2j * torch.pi * right.frequency * 3e-4)[:, None, None]
    assert disagreements(plate(), replace(right, frf=-right.frf * phase)) == ()


def test_an_axis_in_khz_is_named():
    there = measured()
    (said,) = disagreements(plate(), replace(there, frequency=1e-3 * there.frequency))
    assert said.endswith("It would fit a frequency axis in kHz (multiply by 1000).")


def test_sides_in_cm_that_were_taken_for_mm_are_named():
    mesh = replace(RECTANGLE, length_x=RECTANGLE.length_x / 10, length_y=RECTANGLE.length_y / 10)
    (said,) = disagreements(plate(mesh), measured())
    assert "It would fit the sides in centimetres that were read as millimetres (0.48 × 0.37 m)" in said


def over(measurement: Measurement, factor: float, low: float = 0.0, high: float = math.inf) -> Measurement:
    """A part of the band, over an axis times a factor."""
    kept = (measurement.frequency >= low) & (measurement.frequency <= high)
    return replace(measurement, frequency=factor * measurement.frequency[kept], frf=measurement.frf[kept])


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.3])
@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
@pytest.mark.parametrize("band", [(5.0, 400.0), (60.0, 400.0)])
def test_an_axis_in_rad_per_s_is_said_and_neither_level_nor_plate_is_blamed(mesh, noise, band):
    (sentence,) = disagreements(plate(mesh), over(measured(mesh, noise=noise), 2 * math.pi, *band))
    assert "looks like rad/s that are taken for Hz" in sentence
    assert "Divide the frequencies by 2π" in sentence


@pytest.mark.parametrize("factor", [1.0, 1.05, 2.0, 4.0, 9.0, 1 / (2 * math.pi)])
@pytest.mark.parametrize(
    "band",
    [(60.0, 400.0), *(pytest.param(band, marks=pytest.mark.check) for band in ((5.0, 400.0), (5.0, 120.0)))],
)
@pytest.mark.check
def test_another_factor_of_the_axis_is_no_rad_per_s(factor, band):
    """None of them is 2π times what the intervals of the modulus leave open, 0.87 to 1.2."""
    for mesh in (RECTANGLE, SQUARE):
        assert not any("rad/s" in one for one in disagreements(plate(mesh), over(measured(mesh), factor, *band)))


@pytest.mark.check
def test_few_clear_peaks_of_a_damped_plate_are_no_rad_per_s():
    """A model of many modes in the band, of which a few are seen: by chance some stand at 2π times the others."""
    for seed in range(40):
        generator = torch.Generator().manual_seed(seed)
        centre = 300.0 * (2400.0 / 300.0) ** torch.rand(8, generator=generator, dtype=torch.float64)
        frequency = torch.linspace(30.0, 2500.0, 2000, dtype=torch.float64)
        frf = (1 / (centre.square() - frequency[:, None].square() + 0.01j * centre.square())).sum(-1)
        whole = replace(measured(), frequency=frequency, frf=frf[:, None, None].expand(-1, 2, 3).contiguous())
        assert not any("rad/s" in one for one in disagreements(plate(), whole))
