"""The marginal likelihood of one hypothesis over its whole box, by importance sampling.

    Z = ∫ L(u) du ≈ 1/N Σ L(uₖ) / q(uₖ),    uₖ ~ q,

q a mixture of Student's t about each minimum, of one about what was drawn so far, and of the box itself: what falls
outside the box counts nothing, and what was drawn from any of the proposals is weighed by the mean of them all, so that
draws of a poor first one do not stay heavy. Laplace's method takes a Gaussian about each minimum. It lies half outside
the box where the minimum is on a bound, follows no bend (a mass and its place), and knows of nothing between two
minima. Few frequencies fix few numbers: what this is off by is as large as what parts two hypotheses.

Sources: Kong, Liu and Wong, J. American Statistical Association 89 (1994) 278, for the effective number of draws;
Cappé, Guillin, Marin and Robert, J. Computational and Graphical Statistics 13 (2004) 907, for proposals that follow the
draws; Cornuet, Marin, Mira and Robert, Scandinavian J. Statistics 39 (2012) 798, for the mean of all; Hesterberg,
Technometrics 37 (1995) 185, for the box in the mixture.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

# −2 ln L of members.
Cost = Callable[[Float[Tensor, "n_draw n"]], Float[Tensor, " n_draw"]]


@dataclass(frozen=True)
class Drawing:
    """How many members are drawn, and how.

    Args:
        n_draw: members that each round draws [-].
        n_effective: independent draws that an integral is worth: ln Z is known to one part in √n of it, a tenth [-].
        n_round: rounds, at most [-].
        tail: degrees of freedom of Student's t about a minimum: tails that a likelihood has, and still a variance [-].
        narrow: standard deviation that what was drawn so far has at least, on the unit cube: rounding [-].
    """

    n_draw: int = 256
    n_effective: float = 100.0
    n_round: int = 12
    tail: int = 5
    narrow: float = 1e-4


class Peak(NamedTuple):
    """Where a likelihood has a maximum.

    Attributes:
        place: on the unit cube.
        covariance: about it.
    """

    place: Float[Tensor, " n"]
    covariance: Float[Tensor, "n n"]


class Integral(NamedTuple):
    """What was found of one hypothesis.

    Attributes:
        evidence: −2 ln Z.
        n_effective: independent draws that these are worth.
        places: that were drawn, on the unit cube and beyond.
        weight: of each, those within adding up to 1: a sample of the posterior.
    """

    evidence: float
    n_effective: float
    places: Float[Tensor, "n_draw n"]
    weight: Float[Tensor, " n_draw"]


def integrate(cost: Cost, peaks: Sequence[Peak], generator: torch.Generator, settings: Drawing) -> Integral:
    """Draw round by round, until enough draws count.

    Args:
        cost: −2 ln L of members.
        peaks: at least one.
        generator: of the draws.
        settings: how many are drawn, and how many are enough.
    """
    n = len(peaks[0].place)
    mixtures, found, costs = [list(peaks)], [], []
    for _ in range(settings.n_round):
        drawn = _draw(mixtures[-1], n, generator, settings)
        inside = ((drawn >= 0) & (drawn <= 1)).all(dim=-1)
        left = drawn.new_full((len(drawn),), math.inf)
        left[inside] = cost(drawn[inside]).nan_to_num(math.inf)
        found.append(drawn)
        costs.append(left)
        places = torch.cat(found)
        density = torch.stack([_log_density(one, places, settings) for one in mixtures]).logsumexp(dim=0)
        log = -0.5 * torch.cat(costs) - density + math.log(len(mixtures))
        weight = (log - log.max()).softmax(dim=0)
        n_effective = float(1 / weight.square().sum())
        if n_effective >= settings.n_effective:
            break
        mean = weight @ places
        off = places - mean
        spread = (weight[:, None] * off).mT @ off + settings.narrow**2 * torch.eye(n).to(places)
        mixtures.append([*peaks, Peak(mean, spread)])
    return Integral(-2 * float(log.logsumexp(0) - math.log(len(log))), n_effective, places, weight)


def _draw(peaks: Sequence[Peak], n: int, generator: torch.Generator, settings: Drawing) -> Tensor:
    """Some of each peak, and some of the box."""
    n_own = settings.n_draw // (1 + len(peaks))
    parts = [torch.rand(settings.n_draw - n_own * len(peaks), n, generator=generator, dtype=torch.float64)]
    for place, covariance in peaks:
        normal = torch.randn(n_own, n, generator=generator, dtype=torch.float64)
        chi = torch.randn(n_own, settings.tail, generator=generator, dtype=torch.float64).square().mean(dim=-1)
        parts.append(place + normal @ torch.linalg.cholesky(covariance).mT / chi.sqrt()[:, None])
    return torch.cat(parts).to(peaks[0].place)


def _log_density(peaks: Sequence[Peak], drawn: Tensor, settings: Drawing) -> Tensor:
    """Of the mixture as it was drawn."""
    n, nu = drawn.shape[-1], settings.tail
    n_own = settings.n_draw // (1 + len(peaks))
    inside = ((drawn >= 0) & (drawn <= 1)).all(dim=-1)
    of_box = math.log((settings.n_draw - n_own * len(peaks)) / settings.n_draw)
    parts = [torch.where(inside, of_box, -math.inf).to(drawn)]
    for place, covariance in peaks:
        lower = torch.linalg.cholesky(covariance)
        off = torch.linalg.solve_triangular(lower, (drawn - place).mT, upper=False)
        constant = math.lgamma(0.5 * (nu + n)) - math.lgamma(0.5 * nu) - 0.5 * n * math.log(nu * math.pi)
        constant += math.log(n_own / settings.n_draw) - float(lower.diagonal().log().sum())
        parts.append(constant - 0.5 * (nu + n) * torch.log1p(off.square().sum(dim=0) / nu))
    return torch.stack(parts).logsumexp(dim=0)
