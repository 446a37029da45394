"""Search the parameters of several states of one plate at once."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Objective, sensitivity
from torchplate.identification.basis_check import TOLERANCE, in_reduced_basis, wanted
from torchplate.identification.caveats import caveats
from torchplate.identification.identify import evaluated, kind_of
from torchplate.identification.job import Job, Settings
from torchplate.identification.result import Result, Value, finite
from torchplate.identification.states import States
from torchplate.model import basis_error
from torchplate.search import DifferentialEvolution, LeastSquares, Optimizer, Outcome


@dataclass(frozen=True)
class StatesFound:
    """What was found of several states.

    Attributes:
        result: all parameters, the common ones first; natural frequencies are those of the first state.
        by_state: of each state its own part, under its own model's names.
        objectives: of each state, in the basis that was searched in.
    """

    result: Result
    by_state: Mapping[str, Result]
    objectives: Mapping[str, Objective]

    def to_dict(self) -> dict[str, Any]:
        """The content of `result.json`."""
        states = {
            name: {
                "objective": one.objective,
                "gap": one.gap,
                "natural_frequencies_hz": list(one.natural_frequencies_hz),
            }
            | ({} if one.gain is None else {"gain": one.gain})
            for name, one in self.by_state.items()
        }
        return self.result.to_dict() | {"states": states}


@torch.no_grad()
def identify_states(
    states: States,
    search: Optimizer[Any] | LeastSquares | None = None,
    settings: Settings = Settings(),  # noqa: B008  frozen
    run: Callable[[Job], Outcome] = Job.search,
    say: Callable[[str], object] = lambda _: None,
) -> StatesFound:
    """Search the joint parameters of several states.

    Args:
        states: whose mean objective is minimised.
        search: the optimiser; Differential Evolution with its defaults if left out.
        settings: its budget and all that is not the optimiser's own.
        run: does the search; it may show its progress.
        say: is told what is being done, a line each.
    """
    optimizer = search or DifferentialEvolution()
    searched = states.each(lambda one: in_reduced_basis(one, settings.basis, say, settings.precision))
    if not states.model.names:
        nothing = states.model.known.new_zeros(1, 0)
        return _found(states, searched, nothing, None, optimizer, settings)
    outcome = run(Job(searched, optimizer, settings))
    theta = states.model.space.to_si(outcome.best_position[outcome.best_objective.argsort()])
    return _found(states, searched, theta, outcome, optimizer, settings)


def _found(
    states: States,
    searched: States,
    theta: Float[Tensor, "n_search n_parameter"],
    outcome: Outcome | None,
    optimizer: Optimizer[Any] | LeastSquares,
    settings: Settings,
) -> StatesFound:
    best, model = theta[0], states.model
    by_squares = isinstance(optimizer, LeastSquares)
    seen = sensitivity(searched, best, least_squares=by_squares) if model.names else None
    at_bound = model.space.at_bound(best).tolist()
    values = {
        name: Value(float(best[k]), finite(seen.std[k]) if seen else None, model.units[k], at_bound[k])
        for k, name in enumerate(model.names)
    }
    parts: dict[str, Result] = {}
    said: list[str] = [] if seen is None else caveats(searched, best, seen)
    for k, (one, small) in enumerate(zip(states.states, searched.states, strict=True)):
        own = states.theta_of(k, best)
        objective = small.objective
        part = evaluated(one.objective.model, own, optimizer, settings)
        parts[one.name] = dataclasses.replace(
            part,
            parameters={
                name: values[joint_name]
                for name, joint_name in zip(one.objective.model.names, states.names_of(k), strict=True)
            },
            objective=float(objective(own)),
            objective_kind=kind_of(objective),
            gap=float(objective.gap(own)),
            gain=float(objective.gain(own)) if objective.evidence.gain_is_unknown else None,
            status=_status(outcome),
        )
        if objective is one.objective or not len(own):
            continue
        error = basis_error(one.objective.model, objective.model, own[None], *wanted(one.objective))
        if error > TOLERANCE:
            said.append(
                f"On the full model of state '{one.name}' the best member differs by {error:.1e} from what the reduced "
                "basis says. Run again with --set search.basis=full."
            )
    first = next(iter(parts.values()))
    whole = dataclasses.replace(
        first,
        parameters=values,
        objective=float(searched(best)),
        gap=float(searched.gap(best)),
        theta=best,
        gain=None,
        caveats=said,
        correlation=None if seen is None else [[finite(one) for one in row] for row in seen.correlation],
        n_evaluation=0 if outcome is None else int(outcome.n_evaluation.sum()),
        n_generation=0 if outcome is None else int(outcome.n_generation.max()),
        repeats={"objective": searched(theta).tolist(), "theta": theta.tolist()} if len(theta) > 1 else None,
    )
    objectives = {one.name: one.objective for one in searched.states}
    return StatesFound(whole, parts, objectives)


def _status(outcome: Outcome | None) -> str:
    if outcome is None:
        return "The models were evaluated: they have no interval to search."
    return outcome.status[int(outcome.best_objective.argmin())].value
