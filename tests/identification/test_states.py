"""One plate in several states: what is common, what is each state's own, and what a search of all at once finds."""

import pytest
import torch

from torchplate.discrepancy import Evidence
from torchplate.effects import CATALOGUE
from torchplate.identification import PlateState, States, identify
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh
from torchplate.search import DifferentialEvolution, LeastSquares

KNOWN = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003, "wires.viscous_damping": 1.0}
BOX = {"plate.youngs_modulus": Searched(1.7e11, 2.4e11), "wires.stiffness": Searched(2e3, 5e4, True)}
YOUNG, BEFORE, AFTER = 2.05e11, 2.0e4, 8.0e3


def plate(stiffness: float | None = None, box: dict[str, Searched] = BOX) -> PlateModel:
    effects = {"plate": CATALOGUE["plate"](), "wires": CATALOGUE["support_spring"](nodes=[2, 4, 17, 19])}
    true = {} if stiffness is None else {"plate.youngs_modulus": YOUNG, "wires.stiffness": stiffness}
    return PlateModel(Mesh(0.43, 0.3, 4, 3), effects, KNOWN | true, None if stiffness else box)


def table(stiffness: float) -> Evidence:
    frequency = plate(stiffness).natural_frequencies(torch.zeros(0, dtype=torch.float64), 9)
    return Evidence(natural_frequencies=NaturalFrequencies.from_mapping(dict(enumerate(frequency.tolist(), 1))))


def pair(own: tuple[str, ...] = ("wires.stiffness",)) -> States:
    return States(
        [
            PlateState.of("before", plate(), table(BEFORE)),
            PlateState.of("after", plate(), table(AFTER), own=own),
        ]
    )


def test_a_states_own_parameter_stands_behind_the_common_ones():
    states = pair()
    assert states.model.names == ("plate.youngs_modulus", "wires.stiffness", "wires.stiffness@after")
    theta = torch.tensor([YOUNG, 1.0e4, 3.0e4], dtype=torch.float64)
    assert states.theta_of(0, theta).tolist() == [YOUNG, 1.0e4]
    assert states.theta_of(1, theta).tolist() == [YOUNG, 3.0e4]


def test_the_objective_is_the_mean_over_states():
    states, theta = pair(), torch.tensor([1.9e11, 1.0e4, 3.0e4], dtype=torch.float64)
    each = [one.objective(states.theta_of(k, theta)) for k, one in enumerate(states.states)]
    assert float(states(theta)) == pytest.approx(float(sum(each)) / 2)
    assert float(each[0]) != pytest.approx(float(each[1]))


def test_two_states_find_a_common_modulus_and_wires_of_their_own():
    found = identify(pair(), search=LeastSquares(n_member=2), n_generation=30)
    truth = {"plate.youngs_modulus": YOUNG, "wires.stiffness": BEFORE, "wires.stiffness@after": AFTER}
    # Tables without an error: what is left is where least squares stops.
    assert {name: one.value for name, one in found.parameters.items()} == pytest.approx(truth, rel=1e-4)
    assert all(one.std is not None for one in found.parameters.values())


@pytest.mark.check
def test_a_population_search_of_several_states_is_polished_where_that_is_asked():
    told: list[str] = []
    search = DifferentialEvolution(n_member=8)
    found = identify(pair(), search=search, n_generation=5, polish=True, say=told.append)
    truth = {"plate.youngs_modulus": YOUNG, "wires.stiffness": BEFORE, "wires.stiffness@after": AFTER}
    # Five generations of eight members end some per cent off; least squares on tables without an error ends there.
    assert {name: one.value for name, one in found.parameters.items()} == pytest.approx(truth, rel=1e-4)
    assert any(text.startswith("polished by least squares") for text in told)


@pytest.mark.check
def test_common_wires_cannot_fit_two_states_whose_wires_differ():
    found = identify(pair(own=()), search=LeastSquares(n_member=2), n_generation=30)
    assert set(found.parameters) == {"plate.youngs_modulus", "wires.stiffness"}
    assert found.gap is not None
    assert found.gap > 0.01


def test_what_cannot_be_one_plate_is_said():
    one = PlateState.of("before", plate(), table(BEFORE))
    with pytest.raises(ValueError, match="'before' twice"):
        States([one, one])
    with pytest.raises(ValueError, match=r"among those it searches .*'wires.stifness'"):
        PlateState.of("after", plate(), table(AFTER), own=("wires.stifness",))
    with pytest.raises(ValueError, match="letters, digits"):
        PlateState.of("a@b", plate(), table(AFTER))
    narrow = BOX | {"wires.stiffness": Searched(2e3, 4e4, True)}
    with pytest.raises(ValueError, match=r"one interval of wires\.stiffness in all states"):
        States([one, PlateState.of("after", plate(box=narrow), table(AFTER))])
    with pytest.raises(ValueError, match="at least one state"):
        States([])
