"""What no plate is is refused, what few are is said, with the unit that was meant; real plates pass without a word."""

import math

import pytest

from torchplate.effects import AirLoading, HystereticDamping, Plate, PointMass, SupportSpring
from torchplate.model import PlateModel, Searched
from torchplate.model.usual_ranges import coarse, impossible, plate_mass, unusual
from torchplate.plate import Mesh

STEEL = {"youngs_modulus": 2.0e11, "poisson_ratio": 0.3, "density": 7860.0, "thickness": 0.0027}


def plate(
    sides: tuple[float, float] = (0.48, 0.37),
    magnet: float = 0.0,
    loss: float = 0.0,
    edges: dict[str, str] | None = None,
    **changes: object,
) -> PlateModel:
    known, searched = {"magnet.x": 0.2, "magnet.y": 0.6, "magnet.mass": magnet, "loss.stiffness_loss_factor": loss}, {}
    for name, value in (STEEL | changes).items():
        if isinstance(value, tuple):
            searched[f"sheet.{name}"] = Searched(*value)
        else:
            known[f"sheet.{name}"] = value
    effects = {"sheet": Plate(), "magnet": PointMass(), "loss": HystereticDamping()}
    return PlateModel(Mesh(*sides, 3, 2, edges=edges or {}), effects, known, searched)


# What is wrong → (changes, key, the values that the sentence proposes).
IMPOSSIBLE = {
    "sides in mm": ({"sides": (480.0, 370.0)}, "mesh.length_x", ["millimetres", "0.48"]),
    "one side in mm": ({"sides": (0.48, 370.0)}, "mesh.length_y", ["millimetres", "0.37"]),
    "thickness in mm": ({"thickness": 2.7}, "effects.sheet.thickness", ["millimetres", "0.0027", "0.37 m"]),
    "modulus in GPa": ({"youngs_modulus": 200.0}, "effects.sheet.youngs_modulus", ["gigapascals", "2e+11"]),
    "modulus in MPa": ({"youngs_modulus": 2e5}, "effects.sheet.youngs_modulus", ["megapascals", "2e+11"]),
    "interval in GPa": (
        {"youngs_modulus": (150.0, 260.0)},
        "effects.sheet.youngs_modulus",
        ["150 to 260", "[1.5e+11, 2.6e+11]"],
    ),
    "density in g/cm³": ({"density": 7.86}, "effects.sheet.density", ["g/cm³", "7860"]),
    "density in t/mm³": ({"density": 7.86e-9}, "effects.sheet.density", ["t/mm³", "7860"]),
    "interval in g/cm³": ({"density": (7.7, 7.9)}, "effects.sheet.density", ["[7700, 7900]"]),
}
UNUSUAL = {
    "modulus in psi": ({"youngs_modulus": 29e6}, "effects.sheet.youngs_modulus", ["pounds per square inch"]),
    "sides in cm": ({"sides": (48.0, 37.0)}, "mesh.length_x", ["centimetres", "0.48"]),
    "thickness in cm": ({"thickness": 0.27}, "effects.sheet.thickness", ["centimetres", "0.0027"]),
    "a block": ({"thickness": 0.06}, "effects.sheet.thickness", ["tenth", "thin-plate"]),
    "mass in g": ({"magnet": 24.0}, "effects.magnet.mass", ["grams", "0.024"]),
    "loss in per cent": ({"loss": 1.5}, "effects.loss.stiffness_loss_factor", ["per cent", "0.015"]),
    "a bridge": ({"sides": (9.0, 8.0), "thickness": 0.19}, "effects", ["kg"]),
}
# Plates that people have: all must pass in silence.
SOUND = {
    "steel": {},
    "spruce": {"youngs_modulus": (1e9, 2e10), "density": 400.0, "thickness": 0.005},
    "cork tile": {"youngs_modulus": (1e7, 1e9), "density": 180.0, "thickness": 0.01},
    "float glass": {"sides": (3.2, 2.2), "youngs_modulus": 7e10, "density": 2500.0, "thickness": 0.01},
    "concrete slab": {"sides": (6.0, 4.0), "youngs_modulus": 3e10, "density": 2400.0, "thickness": 0.15},
    "silicon wafer": {"sides": (0.1, 0.1), "youngs_modulus": 1.6e11, "density": 2330.0, "thickness": 5e-4},
    "cantilever strip": {"sides": (0.0999, 0.02), "thickness": 0.002},
    "magnet": {"magnet": 0.024, "loss": 0.03},
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
def test_what_no_plate_is_names_its_key_and_the_unit_meant(case):
    changes, key, words = IMPOSSIBLE[case]
    found = impossible(plate(**changes))
    assert found is not None
    assert found.key == key
    assert all(word in found.sentence for word in words), found.sentence


@pytest.mark.parametrize("case", UNUSUAL)
def test_what_few_plates_are_is_said_once_and_not_refused(case):
    changes, key, words = UNUSUAL[case]
    model = plate(**changes)
    assert impossible(model) is None
    found = [remark for remark in unusual(model) if remark.key == key]
    assert len(found) == 1
    assert all(word in found[0].sentence for word in words), found[0].sentence


@pytest.mark.parametrize("case", SOUND)
def test_plates_that_people_have_pass_without_a_word(case):
    model = plate(**SOUND[case])
    assert impossible(model) is None
    assert unusual(model) == ()


def test_silicone_rubber_is_possible_and_softer_things_are_not():
    assert impossible(plate(youngs_modulus=1.5e6, density=1100.0)) is None
    # An interval that reaches into what is possible is searched.
    assert impossible(plate(youngs_modulus=(1e5, 2e6))) is None
    assert impossible(plate(youngs_modulus=(1e5, 9e5))) is not None


def test_the_mass_is_that_of_the_bare_plate_over_the_whole_box():
    mass = plate_mass(plate(thickness=(0.002, 0.003), magnet=1.0))
    assert mass == pytest.approx((0.48 * 0.37 * 7860 * 0.002, 0.48 * 0.37 * 7860 * 0.003))


def at(n_along_a_wave: float) -> float:
    """Where elements of the plate above, 0.185 m along its shorter side, have so many along a bending wave [Hz]."""
    rigidity = 2.0e11 * 0.0027**3 / (12 * (1 - 0.3**2))
    wave = n_along_a_wave * 0.37 / 2
    return 2 * math.pi / wave**2 * math.sqrt(rigidity / (7860.0 * 0.0027))


@pytest.mark.parametrize(
    ("n_along_a_wave", "said"), [(1.55, False), (1.5 + 1e-6, False), (1.5 - 1e-6, True), (1.45, True)]
)
def test_a_mesh_is_too_coarse_below_one_and_a_half_elements_along_a_bending_wave(n_along_a_wave, said):
    found = coarse(plate(), at(n_along_a_wave))
    assert len(found) == said
    assert all("3 × 2 elements" in one and f"{n_along_a_wave:.2g} along" in one for one in found)


def test_a_band_that_ends_at_0_hz_says_nothing_of_a_mesh():
    assert coarse(plate(), 0.0) == ()


@pytest.mark.parametrize(("stiffness", "said"), [(0.0, False), (1e-3, True), (2e3, False)])
def test_springs_of_no_stiffness_hang_no_plate_on_long_wires(stiffness, said):
    bare = plate()
    known = bare.known_values | {"wires.stiffness": stiffness, "wires.viscous_damping": 0.0}
    found = unusual(bare.replaced(effects=dict(bare.effects) | {"wires": SupportSpring(nodes=(1, 4))}, known=known))
    assert ["swings" in one.sentence for one in found] == [True] * said


def test_a_plate_that_an_edge_holds_may_have_springs_as_soft_as_any():
    """It does not swing on them."""
    for edges, said in (({}, True), ({"x0": "clamped"}, False), ({"x0": "free"}, True)):
        bare = plate(edges=edges)
        known = bare.known_values | {"wires.stiffness": 1e-3, "wires.viscous_damping": 0.0}
        found = unusual(bare.replaced(effects=dict(bare.effects) | {"wires": SupportSpring(nodes=(1, 4))}, known=known))
        assert any("swings" in one.sentence for one in found) == said


@pytest.mark.parametrize(("density", "said"), [(0.0, False), (1.2e-3, True), (1.2, False)])
def test_air_in_g_per_cubic_centimetre_is_told_from_air_and_from_none(density, said):
    values = {f"sheet.{name}": value for name, value in STEEL.items()} | {"air.density": density}
    model = PlateModel(Mesh(0.48, 0.37, 3, 2), {"sheet": Plate(), "air": AirLoading()}, values)
    found = [remark for remark in unusual(model) if remark.key == "effects.air.density"]
    assert [("1.2" in one.sentence, "g/cm³" in one.sentence) for one in found] == [(True, True)] * said


@pytest.mark.parametrize(("low", "high", "said"), [(0.01, 2.0, True), (0.6, 0.9, True), (0.01, 0.9, False)])
def test_a_loss_factor_is_odd_where_all_of_its_interval_is_large_or_its_end_is_beyond_any(low, high, said):
    bare = plate()
    known = {key: value for key, value in bare.known_values.items() if key != "loss.stiffness_loss_factor"}
    found = unusual(bare.replaced(known=known, searched={"loss.stiffness_loss_factor": Searched(low, high)}))
    assert any("per cent" in one.sentence for one in found) == said
