"""What is said of values: of a model alone, of what it is compared with, and of the search that found them."""

import dataclasses
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Objective, sensitivity
from torchplate.identification.basis_check import TOLERANCE, wanted
from torchplate.identification.caveats import caveats
from torchplate.identification.job import Settings
from torchplate.identification.odd_channels import misread_in
from torchplate.identification.result import MODAL_MODEL, NATURAL_FREQUENCIES, Result, finite, values
from torchplate.model import DENSE, PlateModel, SparseModel, basis_error
from torchplate.search import LeastSquares, Optimizer, Outcome

N_FREQUENCY_LISTED = 20
NOT_SEARCHED = "The model was evaluated: it has no interval to search."


@torch.no_grad()
def evaluated(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    search: Optimizer[Any] | LeastSquares,
    settings: Settings,
) -> Result:
    """A model that is neither searched nor compared with anything: its natural frequencies at theta.

    Args:
        model: the full model.
        theta: in SI units.
        search: had there been one.
        settings: likewise.
    """
    modes = SparseModel(model, theta).modes(N_FREQUENCY_LISTED, dense=model.assembly.size <= DENSE)
    return Result(
        parameters={},
        objective=None,
        objective_kind=None,
        gap=None,
        natural_frequencies_hz=modes.frequency[:N_FREQUENCY_LISTED].tolist(),
        n_evaluation=1,
        n_generation=0,
        status=NOT_SEARCHED,
        seed=settings.seed,
        optimizer=search.name,
        search={"optimizer": search.name} | dataclasses.asdict(settings) | dict(vars(search)),
        theta=theta,
    )


@torch.no_grad()
def compared(
    objective: Objective,
    searched: Objective,
    theta: Float[Tensor, " n_parameter"],
    search: Optimizer[Any] | LeastSquares,
    settings: Settings,
) -> Result:
    """The same beside what it is compared with.

    Args:
        objective: of the full model.
        searched: the same in the basis that was searched in.
        theta: in SI units.
        search: what found them.
        settings: likewise.
    """
    modal = objective.evidence.modal_model
    return dataclasses.replace(
        evaluated(objective.model, theta, search, settings),
        objective=float(searched(theta)),
        objective_kind=_kind_of(objective),
        gap=float(searched.gap(theta)),
        gain=float(searched.gain(theta)) if objective.evidence.gain_is_unknown else None,
        modes=None if modal is None else modal.pairs(searched.model, theta),
    )


@torch.no_grad()
def with_search(
    result: Result,
    searched: Objective,
    theta: Float[Tensor, "n_search n_parameter"],
    outcome: Outcome | None,
    search: Optimizer[Any] | LeastSquares,
) -> Result:
    """The same with the parameters, how well they are known, and how they were found.

    Args:
        result: of the model, or of one state.
        searched: the objective in the basis that was searched in, or that of several states.
        theta: what each search has found, in SI units, the best first.
        outcome: of the searches; None where nothing is searched.
        search: what found them.
    """
    best, objective = theta[0], searched(theta)
    by_squares = isinstance(search, LeastSquares)
    seen = sensitivity(searched, best, least_squares=by_squares) if searched.model.names else None
    # Of several states each has its own.
    misread = misread_in(searched, best) if isinstance(searched.model, PlateModel) else []
    result = dataclasses.replace(
        result,
        parameters=values(searched, best, seen),
        objective=float(objective[0]),
        gap=float(searched.gap(best)),
        theta=best,
        caveats=misread + ([] if seen is None else caveats(searched, best, seen)),
        misread=misread,
        correlation=None if seen is None else [[finite(one) for one in row] for row in seen.correlation],
        repeats={"objective": objective.tolist(), "theta": theta.tolist()} if len(theta) > 1 else None,
    )
    if outcome is None:
        return result
    return dataclasses.replace(
        result,
        n_evaluation=int(outcome.n_evaluation.sum()),
        n_generation=int(outcome.n_generation.max()),
        status=outcome.status[int(outcome.best_objective.argmin())].value,
    )


def off_in_basis(
    objective: Objective, searched: Objective, theta: Float[Tensor, " n_parameter"], of_state: str = ""
) -> tuple[float, list[str]]:
    """How far the basis that was searched in is off at the best, and what has to be known of that, if anything.

    Args:
        objective: of the full model.
        searched: the same in that basis.
        theta: the best, in SI units.
        of_state: name of the plate's state, where it has several.
    """
    error = basis_error(objective.model, searched.model, theta[None], *wanted(objective))
    if error <= TOLERANCE:
        return error, []
    where = f"the full model of state '{of_state}'" if of_state else "the full model"
    return error, [
        f"On {where} the best member differs by {error:.1e} from what the reduced basis says. Run again with --set "
        "search.basis=full."
    ]


def _kind_of(objective: Objective) -> str:
    """The name of what is minimised."""
    if objective.evidence.measurement is not None:
        return objective.kind
    return NATURAL_FREQUENCIES if objective.evidence.modal_model is None else MODAL_MODEL
