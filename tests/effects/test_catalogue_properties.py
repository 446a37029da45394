"""What holds for every effect of the catalogue wherever a search may look for it, present and future.

Numbers are drawn over the priors of an effect's parameters, their ends among them; which laws hold follows from the
class body. A parameter that knows of an axis, and has a name of its own, has to be told to `Move`: else the first test
fails.
"""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.effects.conftest import BARE, REFERENCE, RESPONSE, WIRES

from torchplate.effects import CATALOGUE, Effect, HystereticDamping, Orthotropy, Plate, SupportSpring
from torchplate.effects.parameter import PLATE_SCALE, Parameter
from torchplate.model import PlateModel, Searched
from torchplate.plate import Geometry, Mesh, Section

pytestmark = pytest.mark.check

SETTINGS = settings(
    max_examples=6,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
THETA = torch.zeros(0, dtype=torch.float64)
# Rounding of two eigenproblems: 1e-16 times the highest eigenvalue over the first, 1e5 on these meshes, times a
# resonance's 100. A hole has a hundred millionth of the mass, and so higher ones.
SAME = 1e-8
# Of a sum over some hundred modes that cancel to a hundredth between resonances: 10⁴ times that of a number.
ROUNDING = 1e-12
# The mesh whose labels the examples speak of.
CELLS = (5, 4)
POINTS = [(0.13, 0.2), (0.55, 0.91), (0.8, 0.37)]


@dataclass(frozen=True)
class Case:
    """A plate on two wires with one effect of the catalogue, and where it is read and hit."""

    effect: type[Effect]
    options: Mapping[str, Any]
    value: Mapping[str, float]
    sides: tuple[float, float] = (0.52, 0.37)
    cells: tuple[int, int] = CELLS
    wires: tuple[tuple[float, float], ...] = WIRES
    known: Mapping[str, float] = None  # type: ignore[assignment]
    response: tuple[Any, ...] = tuple(RESPONSE)
    reference: tuple[Any, ...] = tuple(REFERENCE)

    def model(self, searched: Mapping[str, Searched] | None = None, **options: Any) -> PlateModel:
        label = "plate" if self.effect is Plate else "added"
        effects = {"plate": Plate(), "wires": SupportSpring(at=self.wires), "loss": HystereticDamping()}
        effects |= {"grain": Orthotropy(), label: self.effect(**self.options)}
        known = dict(self.known or BARE) | {f"{label}.{name}": number for name, number in self.value.items()}
        intervals = {f"{label}.{name}": ends for name, ends in (searched or {}).items()}
        known = {key: number for key, number in known.items() if key not in intervals}
        mesh = Mesh(*self.sides, *self.cells)
        return PlateModel(
            mesh, effects, known, intervals, list(self.response), list(self.reference), "mobility", **options
        )

    @property
    def lines(self) -> torch.Tensor:
        """From the wires' modes to the fifth or so of bending [Hz]."""
        return torch.tensor([7.0, 41.0, 73.0, 131.0, 287.0], dtype=torch.float64)

    def frf(self) -> torch.Tensor:
        return self.model().frf(THETA, self.lines)


@functools.cache
def bare() -> tuple[Section, Geometry]:
    plan = Case(Plate, {}, {}).model().plan(THETA)
    return plan.section, plan.geometry


def ends(effect: Effect, name: str, example: float) -> tuple[float, float]:
    """Where a search looks for a parameter; where it never does, about the example, within what is allowed."""
    parameter = effect.parameters[name]
    if parameter.prior is not None:
        found = parameter.prior_interval(*bare())
        return found.low, found.high
    low, high = sorted((0.6 * example, 1.4 * example))
    return max(low, parameter.allowed.low), min(high, parameter.allowed.high)


def numbers(effect: type[Effect], example: Any) -> st.SearchStrategy[dict[str, float]]:
    """A value for each of its parameters."""
    whole = effect(**example.options)
    return st.fixed_dictionaries(
        {name: st.floats(*ends(whole, name, number), allow_nan=False) for name, number in example.value.items()}
    )


def distance(found: torch.Tensor, expected: torch.Tensor) -> float:
    assert bool(expected.isfinite().all())
    assert bool(found.isfinite().all())
    return float((found - expected).norm() / expected.norm())


@dataclass(frozen=True)
class Move:
    """The plate seen in a mirror across x, then with its sides exchanged: both are a turn by 90°."""

    mirrored: bool
    transposed: bool

    def place(self, point: Any, cells: tuple[int, int] = CELLS) -> Any:
        if point is None:
            return None
        if isinstance(point, int):
            row, column = divmod(point - 1, cells[0] + 1)
            column = cells[0] - column if self.mirrored else column
            return 1 + (column * (cells[1] + 1) + row if self.transposed else row * (cells[0] + 1) + column)
        x, y = point
        x = 1 - x if self.mirrored else x
        return (y, x) if self.transposed else (x, y)

    def value(self, options: Mapping[str, Any], value: Mapping[str, float]) -> dict[str, float]:
        found = {}
        for name, number in value.items():
            term = re.fullmatch(r"a(\d)(\d)", name)
            if self.mirrored:
                if name in ("x", "x0", "x1"):
                    number = 1 - number
                if name in ("slope_x", "dx", "angle") or (term and int(term[1]) % 2):
                    number = -number
            if self.transposed:
                name = f"a{term[2]}{term[1]}" if term else re.sub(
                    r"^(slope_|d|loss_|)([xy])(\d?)$", lambda m: m[1] + {"x": "y", "y": "x"}[m[2]] + m[3], name
                )  # fmt: skip
                # The axis of the modulus that is called E_x lies along y.
                number = -number if name == "angle" else number
                number = 1 / number if name in ("aspect", "ratio", "young_ratio") else number
            found[name] = number
        if "n_x" not in options:
            return found
        # The nodes of a field's grid count as those of a mesh do.
        grid = options["n_x"] - 1, options["n_y"] - 1
        return {f"value_{self.place(int(name.split('_')[1]), grid)}": number for name, number in value.items()}

    def options(self, options: Mapping[str, Any]) -> dict[str, Any]:
        found = dict(options)
        if self.transposed and "n_x" in options:
            found |= {"n_x": options["n_y"], "n_y": options["n_x"]}
        for name in ("nodes", "at"):
            if name in options:
                found[name] = tuple(self.place(point) for point in options[name])
        if "edge" in options:
            axis, end = options["edge"]
            end = str(1 - int(end)) if self.mirrored and axis == "x" else end
            found["edge"] = ({"x": "y", "y": "x"}[axis] if self.transposed else axis) + end
        if "channels" in options:
            found["channels"] = tuple(tuple(self.place(one) for one in pair) for pair in options["channels"])
        return found

    def of(self, case: Case) -> Case:
        def turned(pair: tuple[Any, Any]) -> tuple[Any, Any]:
            return pair[::-1] if self.transposed else pair

        known = dict(BARE)
        if self.transposed:
            known["grain.young_ratio"] = 1 / known["grain.young_ratio"]
        return replace(
            case,
            options=self.options(case.options),
            value=self.value(case.options, case.value),
            sides=turned(case.sides),
            cells=turned(case.cells),
            wires=tuple(self.place(point) for point in case.wires),
            known=known,
            response=tuple(self.place(point) for point in case.response),
            reference=tuple(self.place(point) for point in case.reference),
        )


MOVES = {
    "a mirror across x": Move(mirrored=True, transposed=False),
    "a mirror across the diagonal": Move(mirrored=False, transposed=True),
    "a turn by 90°": Move(mirrored=True, transposed=True),
}


@pytest.mark.parametrize("move", MOVES)
@SETTINGS
@given(data=st.data())
def test_a_plate_turned_by_90_degrees_or_seen_in_a_mirror_is_the_same_plate(effect, example, move, data) -> None:
    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    assert distance(MOVES[move].of(case).frf(), case.frf()) < SAME


@SETTINGS
@given(data=st.data())
def test_matrices_are_symmetric_and_no_motion_has_negative_energy(effect, example, data) -> None:
    model = Case(effect, example.options, data.draw(numbers(effect, example))).model()
    system, uneven = model.system(THETA), model.plan(THETA).section.uneven_loss
    # What elements lose where the whole plate loses nothing, and what both lose where it does.
    own = model.replaced(known={**model.known_values, "loss.stiffness_loss_factor": 0.0}).system(THETA).hysteretic
    beta = torch.as_tensor(system.proportional.stiffness_loss_factor)
    lossy = () if own is None else (own, system.hysteretic + beta * system.stiffness)
    for matrix in (system.stiffness, system.mass, *lossy):
        assert float((matrix - matrix.mT).abs().max()) <= 1e-15 * float(matrix.abs().max())
        scale = system.mass.diagonal().rsqrt()
        # Rigid motions have no energy, up to rounding of the largest. What a patch covers of an element is integrated
        # to second order in its loss: at a loss factor of 1 motions of that element alone gain some thousandths of what
        # it loses.
        rounding = 1e-14 if uneven is None or not any(matrix is one for one in lossy) else 5e-3
        energy = torch.linalg.eigvalsh(scale[:, None] * matrix * scale)
        assert float(energy.min()) >= -rounding * float(energy.max())


@SETTINGS
@given(data=st.data())
def test_force_and_response_change_places_and_no_force_takes_power_out(effect, example, data) -> None:
    if "sensor chain" in effect.acts_on:
        pytest.skip("it changes what is read, not the plate")
    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    mobility = replace(case, response=tuple(POINTS), reference=tuple(POINTS)).frf()
    assert distance(mobility, mobility.mT) < SAME
    # The power of forces f is ½ fᴴ Re(Y) f, whatever they are.
    power = torch.linalg.eigvalsh(mobility.real)
    assert float(power.min()) > -SAME * float(power.max())
    assert bool((power.amax(-1) > 0).all())


@SETTINGS
@given(data=st.data())
def test_the_modal_sum_is_the_direct_solve_wherever_a_search_looks(effect, example, data) -> None:
    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    model = case.model()
    assert distance(model.frf(THETA, case.lines), model.frf_direct(THETA, case.lines)) < SAME


@SETTINGS
@given(data=st.data(), order=st.permutations(range(2)))
def test_channels_in_another_order_are_the_same_channels(effect, example, data, order) -> None:
    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    other = replace(case, response=tuple(case.response[k] for k in order), reference=case.reference[::-1])
    # Some processors add in another order where a channel stands elsewhere among the others.
    assert distance(other.frf(), case.frf()[:, list(order)].flip(-1)) < ROUNDING


# Powers of kilogram, metre and second.
UNITS = {unit: powers for unit, (powers, _) in PLATE_SCALE.items()}
UNITS |= {"-": (0, 0, 0), "rad": (0, 0, 0), "Pa": (1, -1, -2), "kg/m³": (1, -3, 0)}
# Units in which the laws of a plate have no number of their own; a loss that goes with a power of the frequency is
# given at 100 Hz.
KILOGRAM, METRE, SECOND = 2.0**3, 2.0**-2, 2.0**2


@SETTINGS
@given(data=st.data())
def test_a_plate_in_other_units_is_the_same_plate(effect, example, data) -> None:
    second = 1.0 if effect.name == "frequency_dependent_loss" else SECOND

    def scaled(parameters: Mapping[str, Parameter], value: Mapping[str, float]) -> dict[str, float]:
        powers = {name: UNITS[parameters[name].unit] for name in value}
        return {
            name: number * KILOGRAM ** powers[name][0] * METRE ** powers[name][1] * second ** powers[name][2]
            for name, number in value.items()
        }

    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    bare = {"plate": Plate, "wires": SupportSpring, "loss": HystereticDamping, "grain": Orthotropy}
    known = {}
    for key, number in BARE.items():
        label, name = key.split(".")
        known |= {key: scaled(bare[label].parameters, {name: number})[name]}
    other = replace(
        case,
        known=known,
        value=scaled(effect(**example.options).parameters, case.value),
        sides=tuple(METRE * side for side in case.sides),
    ).model()
    # A mobility is in s/kg.
    found = other.frf(THETA, case.lines / second) * KILOGRAM / second
    assert distance(found, case.frf()) < SAME


PLACED = [
    name
    for name, one in CATALOGUE.items()
    if one.acts_on <= {"mass", "stiffness", "damping"}
    and (one.local is not Effect.local or one.attached is not Effect.attached)
    and one.stage == Effect.stage
]


@SETTINGS
@given(data=st.data())
def test_what_is_attached_at_places_adds_up_in_any_order(effect, example, data) -> None:
    if effect.name not in PLACED:
        pytest.skip("it attaches nothing at places")
    case = Case(effect, example.options, data.draw(numbers(effect, example)))
    plate = Plate()

    def parts(labels: list[str], numbers_of: Mapping[str, float]) -> list[torch.Tensor]:
        kinds = {"added": case.effect(**case.options), "mass": CATALOGUE["point_mass"](), "edge": edge}
        effects = {"plate": plate, **{label: kinds[label] for label in labels}}
        known = {k: v for k, v in numbers_of.items() if k.split(".")[0] in effects}
        system = PlateModel(Mesh(*case.sides, *case.cells), effects, known).system(THETA)
        viscous = system.dashpot.mT @ (system.viscous[:, None] * system.dashpot)
        found = [system.stiffness, system.mass, viscous]
        if system.sprung is None:
            return [*found, torch.zeros_like(viscous)]
        force = system.sprung.force(torch.tensor([300j], dtype=torch.complex128)).abs()
        return [*found, system.carrier.mT @ (force * system.carrier)]

    edge = CATALOGUE["edge_spring"](edge="y0")
    every = BARE | {f"added.{name}": number for name, number in case.value.items()}
    every |= {"mass.x": 0.3, "mass.y": 0.7, "mass.mass": 0.04}
    every |= {"edge.stiffness": 2e4, "edge.rotational_stiffness": 11.0}
    labels = ["added", "mass", "edge"]
    nothing, each = parts([], every), [parts([label], every) for label in labels]
    for order in (labels, labels[::-1]):
        for k, found in enumerate(parts(order, every)):
            expected = nothing[k] + sum(single[k] - nothing[k] for single in each)
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-14 * max(1.0, float(expected.abs().max())))


@SETTINGS
@given(data=st.data())
def test_one_thread_or_two_and_chunks_or_none_give_the_same_members(effect, example, data) -> None:
    value = data.draw(numbers(effect, example))
    whole = effect(**example.options)
    searched = {
        name: Searched(*sorted(pair))
        for name, number in value.items()
        if (pair := (0.9 * number, number))[0] != pair[1] and all(end in whole.parameters[name].allowed for end in pair)
    }
    before, found = torch.get_num_threads(), []
    case = Case(effect, example.options, value)
    try:
        for n_thread, memory in ((1, 2**30), (2, 2**30), (1, 1)):
            torch.set_num_threads(n_thread)
            model = case.model(searched, memory=memory)
            cube = torch.rand(5, len(model.names), generator=torch.Generator().manual_seed(3), dtype=torch.float64)
            found.append(model.frf(model.space.to_si(cube), case.lines))
    finally:
        torch.set_num_threads(before)
    for other in found[1:]:
        assert distance(other, found[0]) < SAME
