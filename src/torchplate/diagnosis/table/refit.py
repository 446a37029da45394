"""The refit of one hypothesis from several starts, and its marginal likelihood by Laplace's method.

    −2 ln Z = −2 ln p(data | û) + Σ ((û − mean) / std)² + ln det(1 + S A S / κ²),    A = JᵀJ on the unit cube

at each minimum û; minima add up, as do mirror images on a plate that is symmetric. S² is std² of what is known
beforehand and 1 / 2π for a parameter that is as likely anywhere in its interval: then a parameter that the data fix
costs the part of its interval that they leave, √(2π / A), and one that they do not see costs nothing; all minima
together hold no more of the prior than there is. One whose minimum lies on a bound, or near it, costs the part of its
likelihood that the interval cuts off. Source: Kass and Raftery, Bayes Factors, J. American Statistical Association 90
(1995) 773.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from scipy.special import log_ndtr
from torch import Tensor

from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.natural import Natural
from torchplate.diagnosis.table.settings import TableSettings
from torchplate.diagnosis.usual import Usual
from torchplate.search import LeastSquaresOutcome, Residual, least_squares

Prior = Mapping[str, tuple[float, float]]
# A parameter this near to an end of its interval is on it, on the unit cube: rounding.
ON_BOUND = 1e-6
NOTHING_USUAL = Usual()
# What a plate turned over has at 1 − u on the unit cube, along x and along y: places, and slopes from −a to a.
AXES = {"x": "y", "slope_x": "slope_y"}


@dataclass(frozen=True, eq=False)
class Minimum:
    """One minimum of a hypothesis.

    Attributes:
        position: on the unit cube.
        chi_square: of the frequencies alone.
        prior: sum of squares of what is known beforehand.
        precision: A / κ² plus 1 / S²: inverse of the posterior covariance on the cube.
        at_bound: which parameters sit on an end of their interval.
        images: positions of the same plate turned over, itself the first.
        turns: which ways of turning these are.
        peak: −2 ln of the likelihood there, and of what is known beforehand.
        evidence: −2 ln Z of it and its images.
        n_effective: parameters that the data fix.
        predicted: natural frequencies [Hz].
    """

    position: Float[Tensor, " n"]
    chi_square: float
    prior: float
    precision: Float[Tensor, "n n"]
    at_bound: Bool[Tensor, " n"]
    images: Float[Tensor, "n_image n"]
    turns: tuple[int, ...]
    peak: float
    evidence: float
    n_effective: float
    predicted: Float[Tensor, " n_mode"]

    def is_near(self, place: Float[Tensor, " n"], limit: float) -> bool:
        """Whether a place, or an image of this one, is within a squared distance in the posterior's metric."""
        off = self.images - place
        return bool(((off @ self.precision) * off).sum(-1).min() < limit)


@dataclass(frozen=True, eq=False)
class Problem:
    """What a hypothesis is fitted to.

    Attributes:
        natural: the model in a basis.
        evidence: the table.
        prior: "label.parameter" → mean and standard deviation.
        settings: constants.
        usual: of its effects, what half of all cases have near no change.
    """

    natural: Natural
    evidence: TableEvidence
    prior: Prior
    settings: TableSettings
    usual: Usual = NOTHING_USUAL

    @property
    def known(self) -> list[tuple[int, float, float]]:
        """Index, mean and standard deviation of what is known beforehand."""
        names = self.natural.model.names
        return [(names.index(name), *told) for name, told in self.prior.items() if name in names]

    def deviations(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_known"]:
        """From what is known beforehand, over its standard deviation."""
        theta = self.natural.model.space.to_si(position)
        rows = [(theta[..., index] - mean) / std for index, mean, std in self.known]
        return torch.stack(rows, dim=-1) if rows else position.new_zeros(*position.shape[:-1], 0)

    def known_slope(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_known n"]:
        """How these change with the position."""
        step = 1e-6
        slope = position.new_zeros(*position.shape[:-1], len(self.known), position.shape[-1])
        space = self.natural.model.space
        change = (space.to_si(position + step) - space.to_si(position - step)) / (2 * step)
        for row, (index, _, std) in enumerate(self.known):
            slope[..., row, index] = change[..., index] / std
        return slope

    def minima(
        self,
        starts: Float[Tensor, "n_start n"],
        n_iteration: int | None = None,
        turns: tuple[int, ...] | None = None,
        hopeless: float = math.inf,
    ) -> list[Minimum]:
        """The minima that the starts lead to, the best first; one without parameters is where it is.

        Args:
            starts: on the unit cube.
            n_iteration: of all starts; left out, a few of all and the settings' of the best.
            turns: mirror images that are known to be the same plate; left out, they are looked for.
            hopeless: χ² beyond which, after a few steps, a way is not followed to its end.
        """
        settings, n = self.settings, self.natural.n_parameter
        if not n:
            return [self.minimum(starts[0], turns)]
        weight = 1.0
        for _ in range(2 if self.known else 1):
            residual, jacobian = self._functions(weight)
            if len(starts) > 1 and n_iteration is None:
                # What is far above the best after a few steps is seldom worth more.
                found = _descended(residual, jacobian, starts, settings.n_first)
                some = found.objective.argsort()[: settings.n_onward]
                starts = found.position[some]
                if float(found.residual[some[0], : self.evidence.n].square().sum()) > hopeless:
                    break
            found = _descended(residual, jacobian, starts, n_iteration or settings.n_iteration)
            # One factor on all variances does not scale what is known beforehand.
            starts = found.position
            best = found.residual[found.objective.argmin(), : self.evidence.n]
            weight = self.evidence.kappa_square(float(best.square().sum())) ** 0.5
        chi = found.residual[:, : self.evidence.n].square().sum(-1)
        cost = [self.evidence.minus_two_log_likelihood(float(one)) for one in chi]
        order = sorted(range(len(cost)), key=lambda k: cost[k])
        kept: list[Minimum] = []
        for k in order:
            if cost[k] > cost[order[0]] + settings.far:
                break
            place = found.position[k]
            if any(self._same(one, place) for one in kept):
                continue
            kept.append(self.minimum(place, turns))
        if turns is None:
            # A mirror image that is nearly the same plate, but for its wires, is a minimum of its own.
            others = self._nearly_alike(kept[0])
            ends = _descended(residual, jacobian, others, settings.n_first).position if len(others) else others
            for one in map(self.minimum, ends):
                if one.peak < kept[0].peak + settings.far and not any(self._same(end, one.position) for end in kept):
                    kept.append(one)
        return sorted(kept, key=lambda one: one.evidence)

    def followed(
        self, starts: Float[Tensor, "n_start n"], n_iteration: int
    ) -> tuple[Float[Tensor, "n_start n"], Float[Tensor, " n_start"]]:
        """Where starts lead in so many iterations, and χ² there.

        Args:
            starts: on the unit cube.
            n_iteration: of each.
        """
        found = _descended(*self._functions(1.0), starts, n_iteration)
        return found.position, found.residual[:, : self.evidence.n].square().sum(-1)

    def _functions(self, weight: float) -> tuple[Residual, Residual]:
        """Residuals and their Jacobian, what is known beforehand weighed by so much."""

        def residual(position: Tensor) -> Tensor:
            off = self.evidence.residual(self.natural.frequency(position))
            return torch.cat([off, weight * self.deviations(position)], dim=-1)

        def jacobian(position: Tensor) -> Tensor:
            slope = self.natural.slope(position) / self.evidence.std[:, None]
            return torch.cat([slope, weight * self.known_slope(position)], dim=-2)

        return residual, jacobian

    def _nearly_alike(self, one: Minimum) -> Float[Tensor, "n_image n"]:
        """Mirror images of a minimum that are not the same plate, and not far above it."""
        turned = [place for k, place in enumerate(self.turned(one.position)) if k not in one.turns]
        places = torch.stack(turned) if turned else one.position.new_zeros(0, len(one.position))
        if not turned:
            return places
        off = self.evidence.residual(self.natural.frequency(places)).square().sum(-1)
        cost = self.evidence.minus_two_log_likelihoods(off) + self.deviations(places).square().sum(-1)
        near = cost < one.peak + self.settings.far
        return places[near & torch.tensor([not self._same(one, place) for place in places])]

    def _same(self, one: Minimum, place: Tensor) -> bool:
        return one.is_near(place, self.settings.same)

    def minimum(self, position: Float[Tensor, " n"], turns: tuple[int, ...] | None = None) -> Minimum:
        """What there is to say of a minimum at this place, its mirror images known or looked for."""
        settings, n = self.settings, len(position)
        predicted = self.natural.frequency(position[None])[0]
        off = self.evidence.residual(predicted)
        chi = float(off.square().sum())
        told = self.deviations(position)
        cost = peak = self.evidence.minus_two_log_likelihood(chi) + float(told.square().sum())
        kappa = self.evidence.kappa_square(chi)
        slope = self.natural.slope(position[None])[0] / self.evidence.std[:, None]
        information = slope.mT @ slope / kappa
        known_slope = self.known_slope(position)
        before = position.new_full((n,), settings.volume)
        if self.known:
            own = known_slope.square().sum(0)
            before = torch.where(own > 0, own, before)
        precision = information + torch.diag(before)
        scaled = information / before.sqrt() / before.sqrt()[:, None] + torch.eye(n).to(before)
        cost += float(torch.linalg.slogdet(scaled).logabsdet) if n else 0.0
        gradient = slope.mT @ off / kappa + known_slope.mT @ told
        bound = (position <= ON_BOUND) | (position >= 1 - ON_BOUND)
        if n:
            cost += _cut_off(position, gradient, precision, before, bound)
        if self.usual.of_effects:
            usual = self.usual.of_posterior(position, torch.linalg.inv(precision))
            cost, peak = cost + usual, peak + usual
        n_effective = float(torch.linalg.solve(precision, information).diagonal().sum()) if n else 0.0
        turned = self.turned(position)
        if turns is None:
            turns = self._turns(turned, predicted, precision)
        images = torch.stack([position, *(turned[k] for k in turns)])
        cost -= 2 * math.log(len(images))
        known = float(told.square().sum())
        return Minimum(position, chi, known, precision, bound, images, turns, peak, cost, n_effective, predicted)

    @functools.cached_property
    def free(self) -> tuple[int, ...]:
        """Parameters that the table sees, or that something is known of beforehand."""
        known = {index for index, _, _ in self.known}
        return tuple(sorted(known | set(self.natural.seen)))

    def cost(self, position: Float[Tensor, "n_member n"]) -> Float[Tensor, " n_member"]:
        """−2 ln of the likelihood times the prior density on the unit cube."""
        off = self.evidence.residual(self.natural.frequency(position))
        found = self.evidence.minus_two_log_likelihoods(off.square().sum(-1))
        told = self.deviations(position)
        if told.shape[-1]:
            rate = self.known_slope(position).sum(-1).abs()
            found = found + (told.square() + math.log(2 * math.pi) - 2 * rate.log()).sum(-1)
        return found + self.usual.at(position)

    def nearest_image(self, position: Float[Tensor, "n_member n"], one: Minimum) -> Float[Tensor, "n_member n"]:
        """The same plates turned over so that they are nearest to a minimum."""
        turned = self.turned(position)
        every = torch.stack([position, *(turned[k] for k in one.turns)])
        nearest = (every - one.position).square().sum(-1).argmin(0)
        return every[nearest, torch.arange(len(position))]

    def turned(self, position: Float[Tensor, "*batch n"]) -> list[Tensor]:
        """The position with all places and slopes mirrored in every way; on a square across the diagonal too."""
        names, space, mesh = self.natural.model.names, self.natural.model.space, self.natural.model.mesh
        along, across = [], []
        for k, name in enumerate(names):
            label, _, key = name.rpartition(".")
            if key in AXES and f"{label}.{AXES[key]}" in names:
                along.append(k)
                across.append(names.index(f"{label}.{AXES[key]}"))
        longer = [k for k, name in enumerate(names) if name.endswith(".aspect")]
        if not along:
            return []
        found = []
        for swapped in (False, True) if mesh.length_x == mesh.length_y else (False,):
            for over_x, over_y in ((False, False), (True, False), (False, True), (True, True)):
                image = position.clone()
                if swapped:
                    image[..., along], image[..., across] = position[..., across], position[..., along]
                    # What is longer along x is then longer along y.
                    image[..., longer] = space.to_cube(1 / space.to_si(position))[..., longer]
                if over_x:
                    image[..., along] = 1 - image[..., along]
                if over_y:
                    image[..., across] = 1 - image[..., across]
                found.append(image)
        return found[1:]

    def _turns(self, turned: list[Tensor], predicted: Tensor, precision: Tensor) -> tuple[int, ...]:
        """Which of them are the same plate and yet another place."""
        if not turned:
            return ()
        found = self.natural.frequency(torch.stack(turned))
        alike = ((found - predicted) / self.evidence.std).abs().amax(-1) < self.settings.alike
        kept: list[int] = []
        for k, same in enumerate(alike.tolist()):
            if same and not any(_near(turned[k] - turned[j], precision, self.settings.same) for j in kept):
                kept.append(k)
        return tuple(kept)


def _near(off: Tensor, precision: Tensor, limit: float) -> bool:
    return float(off @ precision @ off) < limit


def _descended(residual: Residual, jacobian: Residual, starts: Tensor, n_iteration: int) -> LeastSquaresOutcome:
    return least_squares(
        residual,
        starts,
        jacobian=jacobian,
        n_iteration=n_iteration,
        objective_tolerance=1e-4,
        step_tolerance=1e-5,
        jacobian_at_end=False,
    )


def _cut_off(position: Tensor, gradient: Tensor, precision: Tensor, before: Tensor, bound: Tensor) -> float:
    """What the ends of the intervals cut off each parameter's likelihood, −2 ln of it.

    A parameter's profile is exp(−g u − a u²/2) about its minimum; its integral over the interval is held against the
    √(1 / (1 + a / 2π)) that the determinant has taken.
    """
    total = 0.0
    variance = torch.linalg.inv(precision).diagonal()
    for index in range(len(position)):
        if abs(float(before[index]) - 2 * math.pi) > 1e-9:
            # Known beforehand: its interval is many standard deviations wide.
            continue
        a = max(1 / float(variance[index]) - float(before[index]), 1e-9)
        g = float(gradient[index]) if bool(bound[index]) else 0.0
        low, high = -float(position[index]), 1 - float(position[index])
        # ∫ exp(−g t − a t²/2) dt = √(2π/a) exp(g²/2a) (Φ(b) − Φ(a')), ends shifted by g/a; logs, as both may be tiny.
        left, right = (low + g / a) * a**0.5, (high + g / a) * a**0.5
        if left > 0:
            left, right = -right, -left
        bigger, smaller = float(log_ndtr(right)), float(log_ndtr(left))
        inside = bigger + math.log1p(-math.exp(min(smaller - bigger, -1e-15)))
        integral = 0.5 * math.log(2 * math.pi / a) + 0.5 * g * g / a + inside
        taken = -0.5 * math.log1p(a / (2 * math.pi))
        total -= 2 * min(0.0, integral - taken)
    return total


def together(minima: list[Minimum]) -> float:
    """−2 ln of the sum of what the minima hold: Z is a mean of the likelihood over the prior, never above its peak.

    What the data do not fix is as wide as its interval at each minimum: several of them would hold more of the prior
    than there is, and share it instead.
    """
    held, part = torch.tensor(
        [(-0.5 * one.evidence, -0.5 * (one.evidence - one.peak)) for one in minima], dtype=torch.float64
    ).logsumexp(0)
    return -2 * float(held - part.clamp(min=0.0))
