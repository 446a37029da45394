"""What holds for any plate with anything attached: symmetry, energy, scale, and the order of things."""

import math
from dataclasses import dataclass, replace

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchplate.effects import CATALOGUE, Effect
from torchplate.model import PlateModel
from torchplate.plate import Mesh

SETTINGS = settings(max_examples=8, deadline=None, derandomize=True)
NOTHING = torch.zeros(0, dtype=torch.float64)
# Rounding of two eigenproblems: 1e-16 times the highest eigenvalue over the first, 1e5 on these meshes, times a
# resonance's 100.
SAME = 1e-8


@dataclass(frozen=True)
class Specimen:
    """A plate, and what is attached to it: effect, place, and its numbers."""

    sides: tuple[float, float]
    cells: tuple[int, int]
    young: float
    poisson: float
    density: float
    thickness: float
    loss: float
    attached: tuple[tuple[str, tuple[float, float], tuple[tuple[str, float], ...]], ...] = ()

    def model(self, **options: object) -> PlateModel:
        effects: dict[str, Effect] = {"plate": CATALOGUE["plate"](), "loss": CATALOGUE["hysteretic_damping"]()}
        known = {
            "plate.youngs_modulus": self.young,
            "plate.poisson_ratio": self.poisson,
            "plate.density": self.density,
            "plate.thickness": self.thickness,
            "loss.stiffness_loss_factor": self.loss,
        }
        for k, (name, (x, y), numbers) in enumerate(self.attached):
            effects[f"{name}_{k}"] = CATALOGUE[name]()
            known |= {f"{name}_{k}.x": x, f"{name}_{k}.y": y} | {f"{name}_{k}.{key}": value for key, value in numbers}
        return PlateModel(Mesh(*self.sides, *self.cells), effects, known, **options)

    @property
    def first(self) -> float:
        """About where bending begins [Hz]."""
        rigidity = self.young * self.thickness**3 / (12 * (1 - self.poisson**2))
        pulse = 13.5 / max(self.sides) ** 2 * math.sqrt(rigidity / (self.density * self.thickness))
        return pulse / (2 * math.pi)

    def frf(self, points, forces, kind: str = "mobility") -> torch.Tensor:
        lines = torch.tensor([0.31, 0.93, 1.77, 3.1, 4.6], dtype=torch.float64) * self.first
        return self.model().frf(NOTHING, lines, points, forces, kind)

    def moved(self, move) -> "Specimen":
        """The same with all places moved."""
        return replace(self, attached=tuple((name, move(*place), numbers) for name, place, numbers in self.attached))


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


PLACE = st.tuples(number(0.0, 1.0), number(0.0, 1.0))
ATTACHED = st.one_of(
    st.tuples(st.just("point_mass"), PLACE, st.tuples(st.tuples(st.just("mass"), number(0.0, 0.5)))),
    st.tuples(st.just("ground_spring"), PLACE, st.tuples(st.tuples(st.just("stiffness"), number(0.0, 1e5)))),
    st.tuples(st.just("ground_dashpot"), PLACE, st.tuples(st.tuples(st.just("viscous_damping"), number(0.0, 30.0)))),
)
SPECIMEN = st.builds(
    Specimen,
    sides=st.tuples(number(0.2, 1.2), number(0.2, 1.2)),
    cells=st.tuples(st.integers(2, 5), st.integers(2, 4)),
    young=number(5e9, 2.5e11),
    poisson=number(0.0, 0.49),
    density=number(400.0, 9000.0),
    thickness=number(1e-3, 8e-3),
    loss=number(5e-3, 5e-2),
    attached=st.lists(ATTACHED, max_size=3).map(tuple),
)
BARE = SPECIMEN.map(lambda one: replace(one, attached=()))


def distance(found: torch.Tensor, expected: torch.Tensor) -> float:
    return float((found - expected).norm() / expected.norm())


@SETTINGS
@given(SPECIMEN)
def test_stiffness_and_mass_are_symmetric_and_no_motion_has_negative_energy(one: Specimen) -> None:
    system = one.model().system(NOTHING)
    for matrix in (system.stiffness, system.mass):
        assert float((matrix - matrix.mT).abs().max()) <= 1e-15 * float(matrix.abs().max())
    scale = system.mass.diagonal().rsqrt()
    mass, stiffness = (torch.linalg.eigvalsh(scale[:, None] * m * scale) for m in (system.mass, system.stiffness))
    # The unit of a rotation is taken out by the diagonal; what is left of the condition is that of one element.
    assert float(mass.min()) > 1e-4 * float(mass.max())
    # Rigid motions have no energy, up to rounding of the largest.
    assert float(stiffness.min()) > -1e-14 * float(stiffness.max())


@SETTINGS
@given(SPECIMEN, st.lists(PLACE, min_size=2, max_size=2, unique=True))
def test_force_and_response_change_places(one: Specimen, points) -> None:
    found = one.frf(points, points)
    assert distance(found, found.mT) < SAME


@SETTINGS
@given(SPECIMEN, st.lists(PLACE, min_size=2, max_size=3, unique=True))
def test_no_forces_take_power_out_of_the_plate(one: Specimen, points) -> None:
    mobility = one.frf(points, points)
    # The power of forces f is ½ fᴴ Re(Y) f, whatever they are.
    power = torch.linalg.eigvalsh(mobility.real)
    assert float(power.min()) > -SAME * float(power.max())
    assert bool((power.amax(-1) > 0).all())


@SETTINGS
@given(BARE)
def test_free_frequencies_scale_with_modulus_density_thickness_and_size(one: Specimen) -> None:
    frequency = one.model().natural_frequencies(NOTHING, 8)[3:]
    for change, factor in (
        ({"young": 4 * one.young}, 2.0),
        ({"density": 4 * one.density}, 0.5),
        ({"thickness": 2 * one.thickness}, 2.0),
        ({"sides": tuple(2 * side for side in one.sides)}, 0.25),
    ):
        found = replace(one, **change).model().natural_frequencies(NOTHING, 8)[3:]
        assert distance(found, factor * frequency) < SAME, change


@SETTINGS
@given(SPECIMEN, PLACE, PLACE, number(0.2, 5.0))
def test_an_frf_falls_as_all_stiffnesses_masses_and_dashpots_grow(one: Specimen, point, force, factor) -> None:
    grown = tuple((name, place, tuple((k, factor * v) for k, v in numbers)) for name, place, numbers in one.attached)
    heavier = replace(one, young=factor * one.young, density=factor * one.density, attached=grown)
    assert distance(factor * heavier.frf([point], [force]), one.frf([point], [force])) < SAME


@SETTINGS
@given(SPECIMEN, PLACE, PLACE)
def test_a_plate_turned_by_90_degrees_or_seen_in_a_mirror_is_the_same_plate(one: Specimen, point, force) -> None:
    expected = one.frf([point], [force])
    quarter = replace(one, sides=one.sides[::-1], cells=one.cells[::-1])
    for same, move in (
        (quarter, lambda x, y: (1 - y, x)),
        (quarter, lambda x, y: (y, x)),
        (one, lambda x, y: (1 - x, y)),
        (one, lambda x, y: (x, 1 - y)),
    ):
        found = same.moved(move).frf([move(*point)], [move(*force)])
        assert distance(found, expected) < SAME


@SETTINGS
@given(BARE, st.lists(ATTACHED, min_size=2, max_size=4))
def test_what_is_attached_adds_up_in_any_order(one: Specimen, attached) -> None:
    def parts(some) -> list[torch.Tensor]:
        system = replace(one, attached=tuple(some)).model().system(NOTHING)
        return [system.stiffness, system.mass, system.dashpot.mT @ (system.viscous[:, None] * system.dashpot)]

    bare, each = parts(()), [parts([single]) for single in attached]
    for order in (attached, attached[::-1]):
        for k, found in enumerate(parts(order)):
            expected = bare[k] + sum(single[k] - bare[k] for single in each)
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-14 * max(1.0, float(expected.abs().max())))


@SETTINGS
@given(SPECIMEN, st.permutations(range(4)))
def test_channels_in_another_order_are_the_same_channels(one: Specimen, order) -> None:
    points = [(0.13, 0.2), (0.55, 0.91), 1, (0.8, 0.37)]
    found = one.frf([points[k] for k in order], points[:3])
    assert torch.equal(found, one.frf(points, points[:3])[:, list(order)])


@SETTINGS
@given(SPECIMEN)
def test_any_plate_has_the_same_numbers_whoever_stands_beside_it(one: Specimen) -> None:
    from torchplate.model import Searched

    young = one.young
    model = one.model()
    known = {name: float(value) for name, value in model._everything(NOTHING) if name != "plate.youngs_modulus"}
    searched = PlateModel(
        model.mesh, dict(model.effects), known, {"plate.youngs_modulus": Searched(0.5 * young, 2 * young)}
    )
    theta = torch.tensor([[0.7 * young], [young], [1.9 * young]], dtype=torch.float64)
    lines = torch.linspace(0.2, 4.0, 6, dtype=torch.float64) * one.first
    together = searched.frf(theta, lines, [(0.2, 0.3)], [(0.9, 0.1)])
    assert distance(together[1], model.frf(NOTHING, lines, [(0.2, 0.3)], [(0.9, 0.1)])) < SAME
    assert distance(searched.frf(theta[1:2], lines, [(0.2, 0.3)], [(0.9, 0.1)])[0], together[1]) < SAME
