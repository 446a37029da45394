"""The mesh error of the plate that a search has come to, where the middle of the box is another kind of plate."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification.basis_check import confirmed, in_reduced_basis, wanted
from torchplate.identification.job import Settings
from torchplate.identification.polish import polished
from torchplate.identification.states import States
from torchplate.model import retaken
from torchplate.notation import percent
from torchplate.search import Outcome

# Relative change of a natural frequency that is not followed: extrapolation from two meshes leaves as much.
LITTLE = 1e-5
# Times that it is taken off anew: what is left falls with the error's error, a hundredfold and more each time.
MOST = 4


def taken_at(objective: Objective, theta: Float[Tensor, " n_parameter"]) -> tuple[Objective, float] | None:
    """The objective of the model whose mesh error is that of the plate at theta, and how far it was off before.

    Args:
        objective: of the full model.
        theta: in SI units.

    Returns:
        The objective, and the greatest relative change of a natural frequency [-]; None where that is little.
    """
    lines, n_mode = wanted(objective)
    top = None if lines is None else float(lines.max())
    found = retaken(objective.model, theta, top, n_mode)
    if found is None or found[1] <= LITTLE:
        return None
    return objective.of(found[0]), found[1]


def retaken_told(off: float) -> str:
    """What was done about a mesh error by which natural frequencies were off by so much, relative: a sentence."""
    return (
        "The mesh error of the middle of the box leaves the natural frequencies of the plate that was found up to "
        f"{percent(off)} off: it was taken off anew there, and the search finished by least squares."
    )


@torch.no_grad()
def followed(
    objective: Objective,
    searched: Objective,
    outcome: Outcome,
    settings: Settings,
    say: Callable[[str], object] = lambda _: None,
) -> tuple[Objective, Objective, Outcome, float | None]:
    """The mesh error is taken off at the best, and the search finished with it, until both agree.

    Args:
        objective: of the full model.
        searched: the same in the basis that was searched in.
        outcome: of the search.
        settings: of it.
        say: is told of it.

    Returns:
        All three as they are then, and how far natural frequencies were off at first [-]; None where they were not.
    """
    space, first = objective.model.space, None
    for _ in range(MOST):
        best = space.to_si(outcome.best_position[outcome.best_objective.argmin()])
        if (found := taken_at(objective, best)) is None:
            break
        objective, off = found
        if first is None:
            first = off
            say(retaken_told(off))
        searched = in_reduced_basis(objective, settings.basis, precision=settings.precision)[0]
        again = outcome._replace(best_objective=searched(space.to_si(outcome.best_position)))
        outcome = polished(searched, again, say, weighted=True)
        if searched is not objective:
            searched, outcome = confirmed(objective, searched, outcome, say)
    return objective, searched, outcome, first


@torch.no_grad()
def followed_in_states(
    states: States,
    searched: States,
    outcome: Outcome,
    settings: Settings,
    say: Callable[[str], object] = lambda _: None,
) -> tuple[States, States, Outcome, float | None]:
    """The same of several states, of each at its own plate.

    Args:
        states: of the full models.
        searched: the same in the bases that were searched in.
        outcome: of the search.
        settings: of it.
        say: is told of it.
    """
    space, first = states.model.space, None
    for _ in range(MOST):
        best = space.to_si(outcome.best_position[outcome.best_objective.argmin()])
        found = [taken_at(one.objective, states.theta_of(k, best)) for k, one in enumerate(states.states)]
        if (off := max((one[1] for one in found if one is not None), default=None)) is None:
            break
        if first is None:
            first = off
            say(retaken_told(off))
        pairs = zip(states.states, found, strict=True)
        states = states.replaced([own.objective if one is None else one[0] for own, one in pairs])
        searched = states.each(lambda one: in_reduced_basis(one, settings.basis, precision=settings.precision)[0])
        again = outcome._replace(best_objective=searched(space.to_si(outcome.best_position)))
        outcome = polished(searched, again, say, weighted=True)
    return states, searched, outcome, first
