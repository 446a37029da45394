"""Where a fit begins when nothing is known of where it ends: members spread over the box, and the basins they lead to.

With few lines, or modes that lie close, smoothed residuals have several minima, and the lowest of them need not be that
of the likelihood. Each basin is therefore fitted to its end, and the likelihood decides.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.fit import NOBODY, Beat, fit
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior, Problem, widely
from torchplate.diagnosis.selection.criterion import is_noise
from torchplate.model import PlateModel


def fit_from_the_box(
    builder: ModelBuilder,
    model: PlateModel,
    prior: Prior,
    start: Float[Tensor, "n_start n"] | None = None,
    free: list[int] | None = None,
    before: Fit | None = None,
) -> Fit:
    """The fit of a model whose parameters may be anywhere in their intervals.

    Args:
        builder: what builds and evaluates it.
        model: in all dofs.
        prior: what is known of its parameters beforehand.
        start: positions on the unit cube, the best first; the middle where it is left out.
        free: parameters that are spread; left out, all of them. The others stay where the first start has them.
        before: where it ended already: what leads nowhere near that is not followed to its end.
    """
    n = len(model.names)
    first = model.known.new_full((1, n), 0.5) if start is None else start
    if not n:
        return fit(builder, model, first, prior, wide=False)
    found: Fit | None = None
    beat = NOBODY if before is None else Beat(before.way, before.cost)
    for basin in _basins(builder, model, prior, first, list(range(n)) if free is None else free):
        least = min((one.square for one in (before, found) if one is not None), default=math.inf)
        limit = builder.target.settings.searching.hopeless * least
        ended = fit(builder, model, basin[None], prior, wide=False, hopeless=limit, beat=beat)
        found = ended if found is None or ended.cost < found.cost else found
        if is_noise(found):
            break
    assert found is not None
    return found


def _basins(
    builder: ModelBuilder, model: PlateModel, prior: Prior, first: Float[Tensor, "n_start n"], free: list[int]
) -> list[Float[Tensor, " n"]]:
    """Where members spread over the box end at the wide levels, the best first, each basin once."""
    settings = builder.target.settings.searching
    members = torch.cat([first, _spread(model, prior, first[0], free, settings.n_spread)])
    theta = model.space.to_si(first[0])
    problem = Problem(builder, builder.reduced(builder.corrected(model, theta).model, theta[None]), prior)
    value = problem.squares(members, 0)
    ends = members[value.argsort()[: settings.n_descend]]
    ends, _ = widely(problem, ends, keep=settings.n_descend // 2)
    basins: list[Tensor] = []
    for end in ends:
        if all(float((end - other).abs().max()) > settings.same for other in basins):
            basins.append(end)
    return basins[: settings.n_basin]


def _spread(
    model: PlateModel, prior: Prior, first: Float[Tensor, " n"], free: list[int], n: int
) -> Float[Tensor, "n_member n"]:
    """Members spread over the box; where something is known of a parameter beforehand, over what that says."""
    spread = first.repeat(n, 1)
    sobol = SobolEngine(len(free)).draw(n, dtype=torch.float64).to(first)
    spread[:, free] = sobol
    theta = model.space.to_si(spread)
    for column, index in enumerate(free):
        if (known := prior.get(model.names[index])) is not None:
            quantile = torch.special.ndtri(sobol[:, column].clamp(0.01, 0.99))
            theta[:, index] = known[0] + known[1] * quantile
    return model.space.to_cube(theta).clamp(0.0, 1.0)
