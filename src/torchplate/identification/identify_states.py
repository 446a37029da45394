"""Search the parameters of several states of one plate at once."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification.basis_check import in_reduced_basis
from torchplate.identification.evaluation import compared, off_in_basis, with_search
from torchplate.identification.job import Job, Settings
from torchplate.identification.mesh_error import followed_in_states
from torchplate.identification.odd_channels import misread_in
from torchplate.identification.polish import polished
from torchplate.identification.result import Result
from torchplate.identification.states import States
from torchplate.search import DifferentialEvolution, LeastSquares, Optimizer, Outcome

NOT_SEARCHED = "The models were evaluated: they have no interval to search."


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
    searched = states.each(lambda one: in_reduced_basis(one, settings.basis, say, settings.precision)[0])
    if not states.model.names:
        nothing = states.model.known.new_zeros(1, 0)
        return _found(states, searched, nothing, None, optimizer, settings)
    outcome = run(Job(searched, optimizer, settings))
    if settings.polish and not isinstance(optimizer, LeastSquares):
        outcome = polished(searched, outcome, say)
    states, searched, outcome, off = followed_in_states(states, searched, outcome, settings, say)
    theta = states.model.space.to_si(outcome.best_position[outcome.best_objective.argsort()])
    found = _found(states, searched, theta, outcome, optimizer, settings)
    told = {name: dataclasses.replace(one, mesh_error_moved=off) for name, one in found.by_state.items()}
    return dataclasses.replace(found, result=dataclasses.replace(found.result, mesh_error_moved=off), by_state=told)


def _found(
    states: States,
    searched: States,
    theta: Float[Tensor, "n_search n_parameter"],
    outcome: Outcome | None,
    optimizer: Optimizer[Any] | LeastSquares,
    settings: Settings,
) -> StatesFound:
    best = theta[0]
    parts: dict[str, Result] = {}
    said: list[str] = []
    misread: list[str] = []
    for k, (one, small) in enumerate(zip(states.states, searched.states, strict=True)):
        own = states.theta_of(k, best)
        parts[one.name] = compared(one.objective, small.objective, own, optimizer, settings)
        if small.objective is not one.objective and len(own):
            said += off_in_basis(one.objective, small.objective, own, one.name)[1]
        odd = misread_in(small.objective, own)
        parts[one.name] = dataclasses.replace(parts[one.name], misread=odd)
        misread += [f"State '{one.name}': {sentence}" for sentence in odd]
    first = dataclasses.replace(next(iter(parts.values())), gain=None, modes=None, status=NOT_SEARCHED)
    whole = with_search(first, searched, theta, outcome, optimizer)
    whole = dataclasses.replace(whole, caveats=misread + whole.caveats + said, misread=misread)
    for k, one in enumerate(states.states):
        pairs = zip(one.objective.model.names, states.names_of(k), strict=True)
        own_values = {name: whole.parameters[joint] for name, joint in pairs}
        parts[one.name] = dataclasses.replace(parts[one.name], parameters=own_values, status=whole.status)
    return StatesFound(whole, parts, {one.name: one.objective for one in searched.states})
