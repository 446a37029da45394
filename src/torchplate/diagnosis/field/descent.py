"""Gauss and Newton's steps of a field and the other parameters together: from smoothed spectra to sharp ones.

FRFs are linear in a field only as long as no peak moves by more than its width. So the first steps are those of
spectra smoothed over 5 %, 2 % and 0.7 % of the frequency, beside a smooth prior; the sharp ones come after, each from a
new linearisation, with form and strength of the prior chosen anew by cross-validation. Beside the noise stands what
the model as such leaves: a part of the level around each line, as large as brings the mean square of what is left to
one. It shrinks as the field grows, so that a peak that is still off its place does not decide alone.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.field.field_model import FieldModel
from torchplate.diagnosis.field.strength import Chosen, Products, cross_validated, forms, solved
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.lines import every_nth
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import Found, Marginal
from torchplate.search import JACOBIANS


class Place(NamedTuple):
    """Where a descent is.

    Attributes:
        position: of the model's own parameters, on the unit cube.
        values: of the field.
        about: the specimen.
        chosen: prior of the field, and how well it predicts; None before the sharp level.
        seen: what a unit of each value of a stiffness does to the FRFs, its square in those of what is left; None
            before likewise, and of all else.
    """

    position: Float[Tensor, " n_own"]
    values: Float[Tensor, " n_value"]
    about: Found | None = None
    chosen: Chosen | None = None
    seen: Float[Tensor, " n_value"] | None = None


class _Linear(NamedTuple):
    """Residuals and their Jacobian at a place; the last rows are of what is known beforehand."""

    residual: Float[Tensor, " n_row"]
    own: Float[Tensor, "n_row n_own"]
    value: Float[Tensor, "n_row n_value"]
    n_data: int


class FieldDescent:
    """Of one kind of field.

    Args:
        model: with the field.
        prior: what is known of the model's own parameters beforehand.
    """

    def __init__(self, model: FieldModel, prior: Prior) -> None:
        self.model, self.prior = model, prior
        self.target = model.builder.target
        self.settings = self.target.settings.inferring

    def start(self, fit: Fit) -> Place:
        """No field.

        Args:
            fit: of the model without one.
        """
        position = self.model.base.space.to_cube(fit.theta).clamp(0.0, 1.0)
        return Place(position, fit.theta.new_zeros(len(self.model.effect.parameters)), fit.about)

    def rebased(self, place: Place) -> None:
        """From here on in the modes of the plate at a place."""
        self.model.rebased(self.model.base.space.to_si(place.position), place.values)

    def widely(self, place: Place) -> Place:
        """After a few steps at each wide level, beside a smooth prior; from a single value beside a sparse one."""
        alone = bool((place.values != 0).any())
        told = self.target.settings.wide.told
        for level in range(self.target.levels - 1):
            before = math.inf
            for _ in range(self.settings.n_wide):
                problem = Problem(self.model.builder, self.model.specimen(None), self.prior)
                linear = self._linear(problem, place, level)
                left = float(linear.residual.square().sum())
                if left > self.settings.level * before:
                    break
                before = left
                # A single value may have fallen to none.
                shapes = forms(self.model.grid, place.values, self.settings)
                shape = shapes.get("sparse", shapes["smooth"]) if alone else shapes["smooth"]
                weight = told**2 * linear.n_data / self.model.unit**2
                there = self._stepped(problem, place, linear, weight * shape, level)
                if there is place:
                    break
                place = there
        return place

    def bumps(self, place: Place) -> list[Place]:
        """The best fields of a single value, by spectra smoothed most: what is local is not found from none.

        Args:
            place: of the other parameters.
        """
        sizes = [one * self.model.unit for one in self.settings.bumps if one * self.model.unit >= self.model.low]
        values = torch.cat([one * torch.eye(len(place.values)).to(place.values) for one in sizes])
        theta = self.model.base.space.to_si(place.position)
        every = self.model.joined(theta.expand(len(values), -1), values)
        problem = Problem(self.model.builder, self.model.specimen(None), self.prior)
        left = problem.deviations(problem.predict(every, 0), every, 0).square().sum(-1)
        order = left.argsort()[: self.settings.n_bump].tolist()
        return [place._replace(values=values[index], about=None) for index in order]

    def sharply(self, place: Place, part: float) -> Place:
        """After one step at the sharp level.

        Args:
            place: where it begins.
            part: what the model as such leaves, over the level around each line [-].
        """
        target = inflated(self.target, part)
        builder, specimen = self.model.builder.against(target), self.model.specimen(place.about)
        every = self.every(place)
        marginal = target.marginal(specimen, every, place.about)
        problem = Problem(builder, specimen, self.prior, marginal)
        level = target.levels - 1
        linear = self._linear(problem, place, level)
        chosen = cross_validated(
            self._products(linear, place),
            forms(self.model.grid, place.values, self.settings),
            self.settings,
            nonnegative=self.model.low == 0,
        )
        there = self._stepped(problem, place, linear, chosen.precision, level)
        # A free edge does not bend, and what a stiffness is there no FRF says; it moves more than any other place.
        seen = linear.value[: linear.n_data].square().sum(0) if self.model.kind == "stiffness" else None
        return there._replace(about=self._specimen(marginal, there), chosen=chosen, seen=seen)

    def left(self, place: Place) -> Tensor:
        """What was measured less what the specimen would show."""
        seen = self.model.builder.predict(self.model.specimen(place.about), self.every(place))
        return self.target.off(seen, place.about)

    def _specimen(self, marginal: Marginal, place: Place) -> Found | None:
        """The specimen as it is found beside the field."""
        found = marginal.judge(marginal.residual(self.left(place))).found
        return None if found is None else found.within(self.target.settings.fitting.farthest)

    def every(self, place: Place) -> Float[Tensor, " n_parameter"]:
        """All parameters, in the model's order."""
        return self.model.joined(self.model.base.space.to_si(place.position), place.values)

    def _linear(self, problem: Problem, place: Place, level: int) -> _Linear:
        target, every = problem.target, self.every(place)
        prediction = problem.predict(every, level)
        here = problem.deviations(prediction, every, level)

        def along(position: Float[Tensor, "*batch n_own"]) -> Tensor:
            moved = self.model.joined(self.model.base.space.to_si(position), place.values)
            return problem.deviations(problem.predict(moved, level), moved, level)

        own = here.new_zeros(len(here), 0)
        if len(place.position):
            own = JACOBIANS["forward"].differentiate(along, place.position[None], here[None])[0]
        columns = self.model.columns(problem.model, every, *target.lines(level))
        columns = target.at_level(problem.model, every, columns, level)
        if problem.marginal is not None:
            found = -problem.marginal.whitened(problem.marginal.over_noise(columns))
        else:
            found = target.residual(columns, level) - target.residual(torch.zeros_like(columns[:1]), level)
        n = found.shape[-1]
        value = here.new_zeros(len(here), len(found))
        value[:n] = found.mT
        return _Linear(here, own, value, n)

    def _products(self, linear: _Linear, place: Place) -> Products:
        """By folds of the FRFs that fits see; where there are too few of them, of lines."""
        jacobian = torch.cat([linear.own, linear.value], dim=-1)
        residual = linear.residual - linear.value @ place.values
        n, k = linear.n_data, linear.own.shape[-1]
        fold = self._folds().to(residual.device)
        rows = [torch.nonzero(fold == one).flatten() for one in range(int(fold.max()) + 1)]
        parts = [(jacobian[row], residual[row]) for row in rows]
        told = jacobian[n:], residual[n:]
        more = torch.diag(torch.cat([jacobian.new_full((k,), UNIFORM), jacobian.new_zeros(len(place.values))]))
        return Products(
            torch.stack([one.mT @ one for one, _ in parts]),
            torch.stack([one.mT @ other for one, other in parts]),
            torch.stack([other.square().sum() for _, other in parts]),
            (told[0].mT @ told[0] + more, told[0].mT @ told[1]),
            sum(map(len, rows)),
            len(place.values),
        )

    def _folds(self) -> Tensor:
        """The fold of each real number of the residuals; −1 of those that no fit sees."""
        fitted, n_line = self.target.fitted, len(self.target.frequency)
        n, n_fold = int(fitted.sum()), self.settings.n_fold
        fold = torch.full((n_line, *fitted.shape, 2), -1, dtype=torch.int64)
        if n < self.target.settings.holding_out.few:
            # Neighbouring lines say the same: blocks of them do less so.
            block = (torch.arange(n_line) * 4 * n_fold // n_line) % n_fold
            fold[:, fitted] = block[:, None, None].expand(-1, n, 2)
        else:
            fold[:, fitted] = (torch.arange(n) % min(n, n_fold))[None, :, None].expand(n_line, -1, 2)
        return fold.flatten()

    def _stepped(
        self, problem: Problem, place: Place, linear: _Linear, precision: Float[Tensor, "n_value n_value"], level: int
    ) -> Place:
        """The step of least squares, damped until it is short enough and leads down (Levenberg and Marquardt)."""
        k, settings = linear.own.shape[-1], self.settings
        jacobian = torch.cat([linear.own, linear.value], dim=-1)
        here = torch.cat([torch.zeros_like(place.position), place.values])
        gram = jacobian.mT @ jacobian
        # The field counted from none, as its prior is.
        right = jacobian.mT @ (linear.residual - linear.value @ place.values)
        matrix = gram.clone()
        matrix[k:, k:] += precision
        farthest = torch.cat(
            [
                place.position.new_full((k,), settings.own_step),
                torch.full_like(place.values, settings.step * self.model.unit),
            ]
        )

        def cost(residual: Tensor, values: Tensor) -> float:
            return float(residual.square().sum() + values @ precision @ values)

        before = cost(linear.residual, place.values)
        for damping in settings.dampings:
            more = damping * gram.diagonal() + settings.unseen * gram.diagonal().max()
            n_nonnegative = len(place.values) if self.model.low == 0 else 0
            x, _ = solved(matrix + torch.diag(more), right - more * here, settings, n_nonnegative)
            step = x - here
            if damping < settings.dampings[-1] and bool((step.abs() > farthest).any()):
                continue
            step = step.clamp(-farthest, farthest)
            position = (place.position + step[:k]).clamp(0.0, 1.0)
            values = (place.values + step[k:]).clamp(min=self.model.low)
            there = place._replace(position=position, values=values)
            every = self.every(there)
            if cost(problem.deviations(problem.predict(every, level), every, level), values) < before:
                return there
        return place


def inflated(target: FrfTarget, part: float) -> FrfTarget:
    """The same, a part of the level around each line beside the noise."""
    more = 0.5 * part**2 * target.smoothing.around
    variance = more if target.model_variance is None else target.model_variance + more
    twin = replace(target, model_variance=variance)
    vars(twin)["smoothing"] = target.smoothing
    return twin


def part_left(target: FrfTarget, off: Tensor) -> float:
    """The part of the level around each line that brings the mean square of what is left to one; 0 for none."""
    fitted = target.fitted
    square, variance = off.abs().square()[:, fitted], target.variance[:, fitted]
    around = target.smoothing.around[:, fitted]
    if float((square / variance).mean()) <= 2:
        return 0.0
    low, high = 1e-5, 10.0
    for _ in range(30):
        part = (low * high) ** 0.5
        above = float((square / (variance + 0.5 * part**2 * around)).mean()) > 2
        low, high = (part, high) if above else (low, part)
    return part


def thinned(target: FrfTarget, most: int, least: int) -> FrfTarget:
    """The same at fewer lines, so that it has so many real numbers at most, and still so many lines."""
    n = 2 * len(target.frequency) * int(target.fitted.sum())
    return every_nth(target, max(1, min(-(-n // most), len(target.frequency) // least)))
