"""Numbers of another material are usual ones: the resonances and the level of the test contradict them."""

import pytest
import torch

from torchplate.effects import EdgeSpring, HystereticDamping, Orthotropy, Plate, PointMass, Searched, SupportSpring
from torchplate.identification import another_plate
from torchplate.measurement import SI_UNIT, Channel, Measurement, place
from torchplate.model import PlateModel
from torchplate.plate import Mesh

STEEL = {"youngs_modulus": 2.02e11, "poisson_ratio": 0.3, "density": 7830.0, "thickness": 0.0027}
SPRUCE = {"youngs_modulus": 3.4e9, "poisson_ratio": 0.1, "density": 430.0, "thickness": 0.0043}
SIDES = {"rectangle": (0.52, 0.39), "square": (0.48, 0.48)}
BOTH_SIDES = pytest.mark.parametrize(
    "sides", [SIDES["rectangle"], pytest.param(SIDES["square"], marks=pytest.mark.check)], ids=list(SIDES)
)
CELLS = 14, 12
AT = ((0.1, 0.0), (0.9, 0.0), (0.1, 1.0), (0.9, 1.0))
PLACES = {"response": [(0.08, 0.13)], "reference": [(0.0, 0.0), (0.31, 0.82), (0.66, 0.27)]}
WOOD = {"grain.young_ratio": 0.09, "grain.shear_factor": 0.75}


def hit(sides, numbers, loss=0.008, gain=1.0, kind="accelerance", grain=None, magnet=0.0, wires=900.0) -> Measurement:
    """The FRFs of a plate on wires, one per cent of noise on them."""
    known = {f"plate.{name}": value for name, value in numbers.items()} | {"loss.stiffness_loss_factor": loss}
    known |= {"magnet.x": 0.27, "magnet.y": 0.68, "magnet.mass": magnet}
    known |= {"wires.stiffness": wires, "wires.viscous_damping": 0.05} | (grain or {})
    effects = {"plate": Plate(), "loss": HystereticDamping(), "wires": SupportSpring(at=AT), "magnet": PointMass()}
    effects |= {"grain": Orthotropy()} if grain else {}
    model = PlateModel(Mesh(*sides, *CELLS), effects, known)
    frequency = torch.arange(20.0, 500.0, 0.5, dtype=torch.float64)
    with torch.no_grad():
        frf = gain * model.frf(model.known[:0], frequency, **PLACES, kind=kind)
    scatter = torch.randn(*frf.shape, 2, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    frf = frf + 0.01 * frf.abs().median() * torch.view_as_complex(scatter)
    ends = {
        name: tuple(Channel(n, "w", (sides[0] * x, sides[1] * y, 0.0)) for n, (x, y) in enumerate(points, start=1))
        for name, points in PLACES.items()
    }
    measured = torch.ones(frf.shape[1:], dtype=torch.bool)
    return Measurement(frequency, frf, measured, **ends, kind=kind, unit=SI_UNIT[kind])


def said(sides, measurement, numbers, gain_is_unknown=False, extra=None, searched=None) -> tuple[str, ...]:
    """What is said of a config with these numbers, E within 20 % of its own either way where it is one number."""
    known = {f"sheet.{name}": value for name, value in numbers.items() if name != "youngs_modulus"}
    modulus = numbers["youngs_modulus"]
    box = {
        "sheet.youngs_modulus": Searched(*(modulus if isinstance(modulus, tuple) else (modulus / 1.2, 1.2 * modulus)))
    }
    box |= {"loss.stiffness_loss_factor": Searched(1e-4, 5e-2, logarithmic=True)} | (searched or {})
    known |= {"wires.stiffness": 800.0, "wires.viscous_damping": 0.5}
    effects = {"sheet": Plate(), "loss": HystereticDamping(), "wires": SupportSpring(at=AT)} | (extra or {})
    model = PlateModel(Mesh(*sides, 9, 8), effects, known, box)
    return another_plate(model, measurement, place(measurement, *sides, 9, 8), gain_is_unknown)


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize("sides", SIDES.values(), ids=SIDES)
@pytest.mark.check
def test_a_test_of_the_plate_itself_passes_without_a_word(sides, kind):
    assert said(sides, hit(sides, STEEL, kind=kind), STEEL) == ()


@BOTH_SIDES
@pytest.mark.parametrize(
    "truth",
    [
        {"loss": 0.03},
        {"loss": 0.001},
        {"magnet": 0.3},
        {"gain": 1.4},
        {"gain": 0.7},
        {"numbers": STEEL | {"thickness": 0.0031}},
    ],
    ids=str,
)
def test_a_plate_that_is_not_quite_the_model_passes_without_a_word(sides, truth):
    """A tenth of the mass as a magnet, other damping, another calibration, another sheet: a diagnosis names these."""
    assert said(sides, hit(sides, **({"numbers": STEEL} | truth)), STEEL) == ()


# What a config has of another plate → words that name it, and words that do not blame another number.
MISTAKES = {
    "density of aluminium": ({"density": 2700.0}, ["density", "steel"], ["youngs_modulus ", "thickness "]),
    "density of lead": ({"density": 20000.0}, ["density", "steel"], ["youngs_modulus ", "thickness "]),
    "modulus of aluminium": ({"youngs_modulus": 7e10}, ["youngs_modulus", "steel"], ["density ", "thickness "]),
    "another sheet": ({"thickness": 0.0054}, ["plate.thickness"], ["youngs_modulus ", "density "]),
    "both of aluminium": ({"youngs_modulus": 7e10, "density": 2700.0}, ["level is 0.3", "steel", "Weigh"], []),
}


@BOTH_SIDES
@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
@pytest.mark.parametrize("case", MISTAKES)
def test_a_number_of_another_plate_is_named(case, kind, sides):
    changes, words, not_blamed = MISTAKES[case]
    (sentence,) = said(sides, hit(sides, STEEL, kind=kind), STEEL | changes)
    assert all(word.replace("plate.", "sheet.") in sentence for word in words), sentence
    assert not any(f"effects.sheet.{word}" in sentence for word in not_blamed), sentence


def test_the_number_that_would_fit_holds_the_plate_s_own():
    sides = SIDES["rectangle"]
    (sentence,) = said(sides, hit(sides, STEEL), STEEL | {"density": 2700.0})
    low, high = (float(word) for word in sentence.partition("density ")[2].split(" (")[0].split(" to "))
    assert low < STEEL["density"] < high
    # E within 20 % either way.
    assert high / low == pytest.approx(1.44, rel=1e-3)


def test_where_the_level_is_unknown_the_resonances_alone_speak():
    sides = SIDES["rectangle"]
    frfs = hit(sides, STEEL, gain=0.02)
    (sentence,) = said(sides, frfs, STEEL | {"density": 2700.0}, gain_is_unknown=True)
    assert all(f"effects.sheet.{name} " in sentence for name in ("density", "youngs_modulus", "thickness"))
    assert "level" not in sentence
    # Of one density and modulus for another of the same ratio the level alone tells.
    both = STEEL | {"youngs_modulus": 7e10, "density": 2700.0}
    assert said(sides, frfs, both, gain_is_unknown=True) == ()


@pytest.mark.parametrize("described", [False, True], ids=["isotropic", "with its grain searched"])
@pytest.mark.check
def test_a_plate_of_wood_with_the_density_of_steel_is_named(described):
    """No isotropic plate is near to it, and one of wood is."""
    sides = (0.58, 0.22)
    frfs = hit(sides, SPRUCE, loss=0.02, grain=WOOD, wires=60.0)
    extra = {"grain": Orthotropy()} if described else None
    box = {"grain.young_ratio": Searched(0.03, 0.3, logarithmic=True), "grain.shear_factor": Searched(0.4, 1.5)}
    right, wrong = (
        said(sides, frfs, SPRUCE | changes, extra=extra, searched=box if described else None)
        for changes in ({}, {"density": 7860.0})
    )
    assert right == ()
    (sentence,) = wrong
    assert "effects.sheet.density" in sentence
    assert "spruce" in sentence


def test_nothing_is_said_where_not_all_natural_frequencies_go_together():
    sides, wrong = SIDES["rectangle"], STEEL | {"density": 2700.0}
    edge = {"edge": EdgeSpring(edge="x0")}
    box = {"edge.stiffness": Searched(1e2, 1e6, logarithmic=True)}
    frfs = hit(sides, STEEL)
    assert said(sides, frfs, wrong) != ()
    assert said(sides, frfs, wrong, extra=edge, searched=box) == ()


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.check) for seed in range(1, 6))])
def test_nothing_is_said_of_a_test_that_no_plate_is_near_to(seed):
    """Peaks at random: some stretch is always the best one."""
    sides, frfs = SIDES["rectangle"], hit(SIDES["rectangle"], STEEL)
    generator = torch.Generator().manual_seed(seed)
    centre = 30.0 * (480.0 / 30.0) ** torch.rand(9, generator=generator, dtype=torch.float64)
    residue = torch.randn(9, 3, generator=generator, dtype=torch.float64)
    line = frfs.frequency[:, None].square()
    frf = (line * (1 / (centre.square() * (1 + 0.01j) - line))) @ residue.to(torch.complex128)
    other = Measurement(
        frfs.frequency, frf[:, None], frfs.measured, frfs.response, frfs.reference, "accelerance", frfs.unit
    )
    assert said(sides, other, STEEL, gain_is_unknown=True) == ()
