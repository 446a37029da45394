"""The basis that is searched in: chosen, confirmed at the best member, enriched or given up where it is wrong."""

from collections.abc import Callable

import torch
from torch import Tensor

from torchplate.discrepancy import Objective
from torchplate.identification.polish import polished
from torchplate.model import DENSE, SINGLE_TOLERANCE, basis_error, estimated_error, reduce
from torchplate.search import Outcome

# Relative FRF norm, or relative error of a natural frequency, beyond which a basis is not believed.
TOLERANCE = 1e-4
# The same of one that only leads to where least squares finish in all dofs: a search tells members apart by gaps of
# tens of percent, and its basins lie peaks apart.
ROUGH = 1e-2
# Dofs from which looking for a basis takes minutes: a factor of 160,000 elements takes seconds, and there are hundreds.
LARGE = 100_000
# Members of the last population, the best first, whose error in the basis is estimated.
N_ESTIMATED = 8


def in_reduced_basis(
    objective: Objective,
    basis: str = "auto",
    say: Callable[[str], object] = lambda _: None,
    precision: str = "double",
    finished: bool = False,
) -> tuple[Objective, float | None]:
    """The same objective in a reduced basis, where one is worth it and good enough, and the error it makes.

    Args:
        objective: of the full model.
        basis: "auto", or "full" for none.
        say: is told which.
        precision: "single" where the search wants it.
        finished: whether what is found is `confirmed` by least squares in all dofs, where the basis is wrong: then a
            rougher one does, if there are few enough of these.
    """
    model = objective.model
    if basis == "full" or (not model.names and model.assembly.size <= DENSE):
        return objective, None
    if model.assembly.size > LARGE:
        say(
            f"looking for a basis of {model.assembly.size} dofs, which takes minutes; a coarser mesh with "
            "mesh.extrapolate says as much"
        )
    rough = ROUGH if finished and model.assembly.size <= DENSE else 0.0
    small = reduce(model, *wanted(objective), rough=rough)
    if small is None:
        if model.assembly.size > DENSE:
            say(
                f"all {model.assembly.size} dofs, since no smaller basis is right over the whole box: each member "
                "takes an eigenproblem of its own; narrower intervals, a lower end of the band or a coarser mesh take "
                "less"
            )
        return objective, None
    vectors = "vectors" if small[0].shared_modes is None else "modes that all members share"
    end = "; the best is held against all dofs" if small[1] > TOLERANCE else ""
    say(
        f"{model.assembly.size} dofs in {small[0].assembly.size} {vectors}: "
        f"error at most {small[1]:.0e} on members they were not built from{end}"
    )
    shared = small[0].shared_modes
    if precision == "single" and shared is not None and shared.single_error > SINGLE_TOLERANCE:
        say(
            f"single precision would be {shared.single_error:.0e} wrong, expected at most {SINGLE_TOLERANCE:.0e}: "
            "the search stays in double precision; narrow the intervals of springs and masses to use it"
        )
    return objective.of(small[0]), small[1]


@torch.no_grad()
def confirmed(
    objective: Objective,
    searched: Objective,
    outcome: Outcome,
    say: Callable[[str], object] = lambda _: None,
    rough: bool = False,
) -> tuple[Objective, Outcome]:
    """The best member is held against the full model; a basis that is wrong there takes it in, or is given up.

    The outcome is then finished by least squares in the better basis, since the optimum has moved by no more than what
    the basis was wrong by.

    Args:
        objective: of the full model.
        searched: the same in the basis that was searched in.
        outcome: of the search.
        say: is told what is done about a wrong basis.
        rough: whether no basis is right over the whole box: then it is given up at once.
    """
    space = objective.model.space
    for more in (not rough, False):
        best = space.to_si(outcome.best_position[outcome.best_objective.argmin()])[None]
        error = basis_error(objective.model, searched.model, best, *wanted(objective))
        if error <= TOLERANCE:
            break
        enriched = reduce(objective.model, *wanted(objective), also=best) if more else None
        if enriched is None and objective.model.assembly.size > DENSE:
            break
        say(
            f"the reduced basis is {error:.0e} wrong at the best member: "
            f"{'it takes that member in' if enriched else 'all dofs from here'}"
        )
        searched = objective if enriched is None else objective.of(enriched[0])
        again = outcome._replace(best_objective=searched(space.to_si(outcome.best_position)))
        outcome = polished(searched, again, say)
        if searched is objective:
            break
    return searched, outcome


def wanted(objective: Objective) -> tuple[Tensor | None, int]:
    """Lines at which FRFs must be right, and the number of natural frequencies that must be."""
    frfs, table, modal = (
        objective.evidence.measurement,
        objective.evidence.natural_frequencies,
        objective.evidence.modal_model,
    )
    n_mode = 0 if table is None else int(table.mode.max())
    return None if frfs is None else frfs.frequency, n_mode if modal is None else modal.n_mode


def estimated(objective: Objective, searched: Objective, outcome: Outcome | None, at_best: float) -> float | None:
    """The greatest estimated error of FRFs among the best members of the last population.

    Args:
        objective: of the full model.
        searched: the same in the basis that was searched in.
        outcome: of the search.
        at_best: the basis's error at the best member.
    """
    lines = wanted(objective)[0]
    if outcome is None or lines is None:
        return None
    basis = searched.model.assembly.basis
    if basis is not None and basis.shape[0] == basis.shape[1]:
        # All dofs are in it: what is wrong is rounding, at one member as at the next, and the residuals of so many
        # vectors take longer than the search.
        return at_best
    order = outcome.fitness.flatten().argsort()[:N_ESTIMATED]
    members = objective.model.space.to_si(outcome.population.flatten(0, -2)[order])
    return float(estimated_error(objective.model, searched.model, members, lines).max())
