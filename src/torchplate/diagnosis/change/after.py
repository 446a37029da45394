"""The test after: fits of what may have changed, all else as the reference says.

With q what the reference has told, parameters and specimen, q̂ its mean and R Rᵀ its covariance, the FRFs of the next
test are H(q̂, p) + ∂H/∂q R ξ + nuisances of that test + noise, ξ ~ N(0, I): the reference is one more group of nuisances
whose size is known, about the very model; so is what the modes' shapes leave open of what p does. p is what changed,
and what has a value of its own in each test.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.reference import Reference, all_columns, eigenvalues
from torchplate.diagnosis.change.specimen import ReferenceSpecimens
from torchplate.diagnosis.judged import Fit, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Problem, widely
from torchplate.discrepancy import Marginal
from torchplate.model import PlateModel, on_mesh

GROUP = "reference"


class Hypothesis(NamedTuple):
    """A model with what may have changed in it, in a basis.

    Attributes:
        whole: in all dofs, mesh error taken off; what the reference has told is searched too.
        frozen: in all dofs, that as numbers.
        specimens: of the reference, in the basis.
        reduced: `frozen` in the basis, as the specimen that was found.
        told: parameters that the reference has told.
        half: R.
        changed: whether anything has.
    """

    whole: PlateModel
    frozen: PlateModel
    specimens: ReferenceSpecimens
    reduced: PlateModel
    told: list[str]
    half: Float[Tensor, "n_all k"]
    changed: bool


@dataclass(frozen=True, eq=False)
class After:
    """The test after.

    Attributes:
        builder: of its model, against it.
        model: its model with its mesh error taken off, all parameters searched that the config searches.
        reference: what the one before has told, with the drift.
        own: parameters with a value of their own in each test.
    """

    builder: ModelBuilder
    model: PlateModel
    reference: Reference
    own: tuple[str, ...]

    def hypothesis(
        self, changes: Sequence[Change], values: Sequence[Mapping[str, float]] = (), by_element: bool | None = None
    ) -> Hypothesis:
        """A model with some changes in it.

        Args:
            changes: in the order they were found.
            values: of their parameters, members whose modes join the basis.
            by_element: whether elements will differ.
        """
        whole = self.model
        for change in changes:
            whole = change.applied(whole)
        free = [name for change in changes for name in change.frees(whole.names)]
        told, half = self.reference.half([*free, *self.own])
        numbers = {name: self.reference.values[name] for name in told if name in whole.names}
        searched = {name: one for name, one in whole.searched.items() if name not in numbers}
        frozen = whole.replaced(known=whole.known_values | numbers, searched=searched)
        start = {name: 0.5 * (one.low + one.high) for name, one in whole.searched.items()}
        start |= {name: value for name, value in self.reference.values.items() if name in start}
        members = [start | dict(one) for one in values] or [start]
        theta = torch.tensor([[one[name] for name in frozen.names] for one in members]).to(frozen.known)
        plain = self.builder.reduced(frozen, theta, by_element)
        specimens = self.reference.specimens(plain, theta[0])
        reduced = specimens.at(self.reference.shift)
        known = [name for name in told if name in whole.names]
        if len(known) < len(told):
            # A number in the config of this test.
            rows = [told.index(name) for name in known] + list(range(len(told), len(half)))
            half = half[rows]
        return Hypothesis(whole, frozen, specimens, reduced, known, half, bool(changes))

    def marginal(self, one: Hypothesis, theta: Float[Tensor, " n"]) -> Marginal:
        """Noise and nuisances of this test, and what the reference leaves open, beside a member."""
        target = self.builder.target
        plain = target.marginal(one.reduced, theta, specimen=False)
        model = on_mesh(one.whole, one.reduced.assembly).with_damping_factors(one.reduced.damping_factor)
        values = {**one.reduced.as_dict(theta)}
        everything = torch.tensor([values[name] for name in model.names]).to(theta)
        columns = all_columns(self.builder, model, one.specimens, everything, one.told)
        known = columns @ one.half.to(columns)
        if not one.changed:
            return plain.beside(known, GROUP)
        return plain.beside(torch.cat([known, self._shapes(one, theta, columns)], dim=-1), GROUP)

    def _shapes(
        self, one: Hypothesis, theta: Float[Tensor, " n"], columns: Complex[Tensor, "n_f n_response n_reference n_all"]
    ) -> Complex[Tensor, "n_f n_response n_reference n_mode"]:
        """What a change does to each mode is as uncertain as the mode's shape is."""
        reference = self.reference
        before, n_mode = reference.eigenvalue, len(reference.eigenvalue)
        after = eigenvalues(one.reduced, theta)[:n_mode]
        moved = 0.5 * (after.clamp(min=1.0) / before.clamp(min=1.0)).log()
        settings, first = reference.settings, len(one.told) + reference.n_section
        std = settings.shape * reference.missed * moved.abs() / settings.mode_stiffness
        return columns[..., first : first + n_mode] * std.to(columns)

    def down(
        self, changes: Sequence[Change], starts: Sequence[Mapping[str, float]]
    ) -> tuple[tuple[Mapping[str, float], ...], float]:
        """Where some starts end at the wide levels, the best first, and what that leaves.

        Args:
            changes: in the model.
            starts: values of what is searched, the best first.
        """
        one = self.hypothesis(changes, starts[:1])
        if not one.frozen.names:
            problem, empty = Problem(self.builder, one.reduced, {}), one.frozen.known.new_zeros(1, 0)
            left = problem.residual(empty, self.builder.target.levels - 2).square().sum()
            return (({},), 0.5 * float(left))
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts])
        n_best = self.builder.target.settings.selecting.n_best
        places, left = widely(Problem(self.builder, one.reduced, {}), places, n_best)
        rows = one.frozen.space.to_si(places).tolist()
        return tuple(dict(zip(one.frozen.names, row, strict=True)) for row in rows), float(left[0])

    def fit(self, changes: Sequence[Change], starts: Sequence[Mapping[str, float]]) -> Fit:
        """The best of some starts, at the sharp level.

        Args:
            changes: in the model.
            starts: values of the parameters that have changed, the best first.
        """
        fitting = self.builder.target.settings.fitting
        one = self.hypothesis(changes, starts[:1])
        names = one.frozen.names
        if not names:
            return self._judged(one, one.frozen.known.new_zeros(0))
        places = torch.stack([_place(one.frozen, start, self.reference.values) for start in starts])
        best: tuple[Fit, Tensor] | None = None
        for place in places:
            found = self._sharply(one, place)
            if best is None or found[0].cost < best[0].cost:
                best = found
        assert best is not None
        fit, place = best
        for _ in range(self.reference.settings.n_turn - 1):
            # In a basis of where it has come to.
            values = dict(zip(names, fit.theta.tolist(), strict=True))
            one = self.hypothesis(changes, [values])
            again, there = self._sharply(one, place)
            moved = float((there - place).abs().max())
            fallen = fit.cost - again.cost
            fit, place = again, there
            if moved < self.reference.settings.rest or abs(fallen) < fitting.little:
                break
        return fit

    def _sharply(self, one: Hypothesis, place: Float[Tensor, " n"]) -> tuple[Fit, Float[Tensor, " n"]]:
        target, fitting, settings = self.builder.target, self.builder.target.settings.fitting, self.reference.settings
        for _ in range(settings.n_turn):
            marginal = self.marginal(one, one.frozen.space.to_si(place))
            problem = Problem(self.builder, one.reduced, {}, marginal)
            there, _, _ = problem.descend(place[None], target.levels - 1, fitting.n_iteration)
            moved = float((there[0] - place).abs().max())
            place = there[0]
            if moved < settings.rest:
                break
        return self._judged(one, place), place

    def _judged(self, one: Hypothesis, place: Float[Tensor, " n"]) -> Fit:
        marginal = self.marginal(one, one.frozen.space.to_si(place))
        return judged_beside(self.builder, one.frozen, one.reduced, {}, place, marginal)


def _place(model: PlateModel, start: Mapping[str, float], values: Mapping[str, float]) -> Float[Tensor, " n"]:
    middle = model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known)).tolist()
    here = dict(zip(model.names, middle, strict=True)) | {k: v for k, v in values.items() if k in model.names}
    theta = torch.tensor([(here | dict(start))[name] for name in model.names]).to(model.known)
    return model.space.to_cube(theta).clamp(1e-3, 1 - 1e-3)


def against_the_next(builder: ModelBuilder, noise_scale: float) -> ModelBuilder:
    """A builder whose test is weighed by what the model leaves of the reference too.

    What no section and no mode explains there, it does not explain here either. The mesh error is in both.
    """
    target = builder.target
    scale = max(1.0, noise_scale)
    noise = replace(target.noise, std=scale * target.noise.std, floor=target.noise.floor)
    nothing = torch.zeros_like(target.frequency)
    return builder.against(replace(target, noise=noise, mesh_shift=nothing))
