"""Hypotheses refitted to a further test, each from where it was, with what was known of it as prior.

The formula of `gain` is linear about where the first test has left each hypothesis. This one is not: the FRFs of the
new test are fitted by least squares, and Laplace's approximation about the end gives the evidence,

    −2 ln Z_i = min_u [ |W (y − H_i(u))|² + (u − û_i)ᵀ P_i (u − û_i) ] + ln |P_i + JᵀJ| − ln |P_i|,

W with noise, nuisances and specimen in it. It is what a second measurement says by itself, and the check of a plan:
with the FRFs that another hypothesis predicts, how far the two are apart if this one does what it can.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.planning.forthcoming import Forthcoming
from torchplate.search import least_squares

# Steps of least squares from each start.
N_ITERATION = 15
# Further starts lie so far to either side [standard deviations], along this many axes at most, where half the bend of
# the FRFs is so large [standard deviations of the noise]: there are basins beside each other only where the way bends.
ASIDE, N_ASIDE, SEEN = 1.5, 2, 3.0


class Refit(NamedTuple):
    """One hypothesis after a further test.

    Attributes:
        position: of its parameters, on the unit cube.
        square: of the residuals and of what was known, together.
        evidence: −2 ln Z, up to a constant of the test.
    """

    position: Float[Tensor, " n"]
    square: float
    evidence: float


@torch.no_grad()
def refitted(test: Forthcoming, index: int, measured: Complex[Tensor, "n_frequency n_response n_reference"]) -> Refit:
    """One hypothesis refitted to a test.

    Args:
        test: how it was, or will be, made.
        index: of the hypothesis.
        measured: FRFs.
    """
    bench = test.benches[index]
    here, axes = bench.here, bench.axes
    open_ = test.white(torch.cat([test.specimen(index), test.common])).mT
    shrink = _shrinking(open_)

    def left(position: Tensor) -> Tensor:
        white = test.white(measured - test.says(index, position))
        return white - ((white @ open_) @ shrink) @ open_.mT

    volume = float(torch.linalg.slogdet(torch.eye(open_.shape[-1]).to(open_) + open_.mT @ open_).logabsdet)
    if not len(here):
        square = float(left(here).square().sum())
        return Refit(here, square, square + volume)
    inverse = torch.linalg.inv(axes)

    def residual(position: Tensor) -> Tensor:
        return torch.cat([left(position), (position - here) @ inverse.mT], dim=-1)

    n = len(here)
    bends = test.predicted(index).columns[:, n : 2 * n].norm(dim=0)
    wide = [k for k in bends.argsort(descending=True)[:N_ASIDE].tolist() if float(bends[k]) > SEEN]
    starts = [here, *(here + sign * ASIDE * axes[:, k] for k in wide for sign in (1.0, -1.0))]
    ended = least_squares(
        residual,
        torch.stack(starts).clamp(0.0, 1.0),
        jacobian="forward",
        n_iteration=N_ITERATION,
        objective_tolerance=1e-4,
        step_tolerance=1e-7,
    )
    best = int(ended.objective.argmin())
    jacobian = ended.jacobian[best] @ axes
    square = 2 * float(ended.objective[best])
    occam = float(torch.linalg.slogdet(jacobian.mT @ jacobian).logabsdet)
    return Refit(ended.position[best], square, square + occam + volume)


def posterior(names: Sequence[str], prior: Sequence[float], evidence: Sequence[float]) -> dict[str, float]:
    """Of each name after a test.

    Args:
        names: of the hypotheses.
        prior: their probabilities before it.
        evidence: −2 ln Z of each.
    """
    p = (torch.tensor(prior, dtype=torch.float64).log() - 0.5 * torch.tensor(evidence, dtype=torch.float64)).softmax(0)
    found: dict[str, float] = {}
    for name, one in zip(names, p.tolist(), strict=True):
        found[name] = found.get(name, 0.0) + one
    return found


def _shrinking(columns: Float[Tensor, "n k"]) -> Float[Tensor, "k k"]:
    """S with (I + B Bᵀ)^−½ = I − B S Bᵀ."""
    value, vector = torch.linalg.eigh(columns.mT @ columns)
    value = value.clamp(min=0.0)
    root = (1 + value).sqrt()
    return (vector / (root * (1 + root))) @ vector.mT
