"""A hypothesis over all its values: its marginal likelihood and a sample of its posterior, by importance sampling.

Laplace's method takes a Gaussian about each minimum. Ten frequencies leave a soft patch's place, size and factor along
a bent valley, and of four wires they fix what these do together: there a Gaussian is too narrow, or lies half outside
the box. A frequency costs little in a reduced basis, so that hypotheses which may be the best are integrated over their
boxes (`torchplate.diagnosis.integral`).

A plate that is symmetric is the same plate with its places mirrored. The basis is right near the best minimum, and
members are taken to the mirror image that lies nearest to it.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.integral import Integral, Peak, integrate
from torchplate.diagnosis.table.refit import Minimum, Problem


def over_the_box(
    problem: Problem, minima: Sequence[Minimum], others: Sequence[Minimum] = (), seed: int = 0
) -> Integral:
    """−2 ln Z of a hypothesis, and draws of all its parameters on the unit cube.

    Args:
        problem: in whose basis the minima are right.
        minima: the best first.
        others: minima of the same hypothesis in other bases: what is nearest to one of them is not this one's.
        seed: of the draws.
    """
    generator = torch.Generator().manual_seed(seed)
    best, free = minima[0].position, list(problem.free)
    near = [one for one in minima if one.evidence < minima[0].evidence + problem.settings.near]
    peaks = [
        Peak(place[free], (turn @ torch.linalg.inv(one.precision) @ turn.mT)[free][:, free])
        for one in near
        for place, turn in zip(one.images, _turns_of(problem, one), strict=True)
    ]

    def cost(some: Tensor) -> Tensor:
        whole = best.repeat(len(some), 1)
        whole[:, free] = some
        found = whole.new_full((len(whole),), math.inf)
        own = _away(whole, near) <= _away(whole, others)
        if bool(own.any()):
            found[own] = problem.cost(problem.nearest_image(whole[own], minima[0]))
        return found

    found = integrate(cost, peaks, generator, problem.settings.drawing)
    places = torch.rand(len(found.places), len(best), generator=generator, dtype=torch.float64).to(best)
    # What neither the table nor anything else says something of is anywhere.
    places[:, free] = found.places
    return found._replace(places=places)


def _away(places: Float[Tensor, "n_draw n"], minima: Sequence[Minimum]) -> Float[Tensor, " n_draw"]:
    """Distance of each place from the nearest of some minima and their images."""
    if not minima:
        return places.new_full((len(places),), math.inf)
    return torch.cdist(places, torch.cat([one.images for one in minima])).amin(-1)


def _turns_of(problem: Problem, one: Minimum) -> list[Float[Tensor, "n n"]]:
    """The matrices that take a place to each of its images."""
    n = len(one.position)
    moved = one.position + torch.eye(n).to(one.position)
    ends, moves = problem.turned(one.position), problem.turned(moved)
    return [torch.eye(n).to(one.position), *((moves[k] - ends[k]).mT for k in one.turns)]


def sample(found: Integral, count: int, seed: int = 0) -> Float[Tensor, "n_draw n"]:
    """So many draws of a posterior on the unit cube, each as often as its weight says."""
    generator = torch.Generator().manual_seed(seed)
    return found.places[torch.multinomial(found.weight, count, replacement=True, generator=generator)]
