"""What may have happened to a plate since the reference test: a model with changes in it, beside what is left open.

With q what the reference has told, parameters and specimen, q̂ its mean and R Rᵀ its covariance, the FRFs of the next
test are H(q̂, p) + ∂H/∂q R ξ + nuisances of that test + noise, ξ ~ N(0, I): the reference is one more group of nuisances
whose size is known, about the very model; so is what the modes' shapes leave open of what p does. p is what changed,
and what has a value of its own in each test.

What the mesh leaves of the plate is the same in both tests. Of a patch it is not: elements that an edge cuts and its
corners, where moments are singular, move a natural frequency by some per cent of what the patch does, many times what a
test is sure of. It is taken off where a change of the section has come to, as it was of the plate before, and what is
left of it is open.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.reference import Reference, all_columns, eigenvalues
from torchplate.diagnosis.change.specimen import ReferenceSpecimens
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.discrepancy import Found, Marginal, OfChannels, matrix_columns
from torchplate.model import PlateModel, on_mesh, solve_modes
from torchplate.plate import Assembly

GROUP = "reference"
Kind = TypeVar("Kind", bound="Hypotheses")


class Hypothesis(NamedTuple):
    """A model with what may have changed in it, in a basis.

    Attributes:
        whole: in all dofs, mesh error taken off; what the reference has told is searched too.
        frozen: in all dofs, that as numbers.
        specimens: of the reference, in the basis.
        reduced: `frozen` in the basis, as the specimen that was found.
        mean: the same without drift.
        told: parameters that the reference has told.
        half: R.
        n_drift: its last columns, which are the drift.
        changed: whether anything has.
        by_mesh: stiffness that the mesh may leave of what has changed, a standard deviation each; None for none.
        about: what the channels have of their own in this test, about which it is; None for nothing.
        drift: since the reference, about which it is, in standard deviations; None for none.
    """

    whole: PlateModel
    frozen: PlateModel
    specimens: ReferenceSpecimens
    reduced: PlateModel
    mean: PlateModel
    told: list[str]
    half: Float[Tensor, "n_all k"]
    n_drift: int
    changed: bool
    by_mesh: Float[Tensor, "n_left n_basis n_basis"] | None = None
    about: Found | None = None
    drift: Float[Tensor, " n_drift"] | None = None


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Of what may have changed, beside the test after.

    Attributes:
        builder: of its model, against it.
        model: its model with its mesh error taken off, all parameters searched that the config searches.
        reference: what the one before has told, with the drift.
        own: parameters with a value of their own in each test.
        anew: with the mesh error taken off where a section has changed; None for that of the plate before.
    """

    builder: ModelBuilder
    model: PlateModel
    reference: Reference
    own: tuple[str, ...]
    anew: Assembly | None = None

    def taken_off_at(self: Kind, changes: Sequence[Change], values: Mapping[str, float]) -> Kind:
        """The same with the mesh error of a plate with these changes; as it is, where none of them is of the section.

        Args:
            changes: in the order they were found.
            values: of their parameters.
        """
        if self.builder.as_given or not any(change.is_of_the_section(self.model) for change in changes):
            return self
        _, frozen, theta = self._models(changes, [values])
        # Where that of both tests was taken off: what has not changed is to leave it as it was.
        there = self.reference.fit.model.as_dict(self.reference.fit.theta)
        told = {name: there[name] for name in self.reference.names if name in frozen.known_values}
        frozen = frozen.replaced(known=frozen.known_values | told)
        return replace(self, anew=self.builder.corrected(frozen, theta[0], anew=True).model.assembly)

    def hypothesis(
        self, changes: Sequence[Change], values: Sequence[Mapping[str, float]] = (), by_element: bool | None = None
    ) -> Hypothesis:
        """A model with some changes in it.

        Args:
            changes: in the order they were found.
            values: of their parameters, members whose modes join the basis.
            by_element: whether elements will differ.
        """
        whole, frozen, theta = self._models(changes, values)
        told, half = self.reference.half(self._free(changes, whole))
        plain = self.builder.reduced(frozen, theta, by_element)
        specimens = self.reference.specimens(plain, theta[0])
        reduced = specimens.at(self.reference.shift)
        known = [name for name in told if name in whole.names]
        if len(known) < len(told):
            # A number in the config of this test.
            rows = [told.index(name) for name in known] + list(range(len(told), len(half)))
            half = half[rows]
        n_drift, by_mesh = self.reference.drift.shape[1], self._left_by_mesh(reduced, theta[0])
        return Hypothesis(whole, frozen, specimens, reduced, reduced, known, half, n_drift, bool(changes), by_mesh)

    def _free(self, changes: Sequence[Change], whole: PlateModel) -> list[str]:
        """Parameters of which the reference says nothing."""
        return [*(name for change in changes for name in change.frees(whole.names)), *self.own]

    def _models(
        self, changes: Sequence[Change], values: Sequence[Mapping[str, float]]
    ) -> tuple[PlateModel, PlateModel, Float[Tensor, "n_member n"]]:
        """In all dofs with some changes in it, the same with what the reference has told as numbers, and members."""
        whole = self.model
        for change in changes:
            whole = change.applied(whole)
        if self.anew is not None:
            whole = on_mesh(whole, self.anew)
        free = self._free(changes, whole)
        told = [name for name in self.reference.names if name not in free and name in whole.names]
        numbers = {name: self.reference.values[name] for name in told}
        searched = {name: one for name, one in whole.searched.items() if name not in numbers}
        frozen = whole.replaced(known=whole.known_values | numbers, searched=searched)
        start = {name: 0.5 * (one.low + one.high) for name, one in whole.searched.items()}
        start |= {name: value for name, value in self.reference.values.items() if name in start}
        members = [start | dict(one) for one in values] or [start]
        theta = torch.tensor([[one[name] for name in frozen.names] for one in members]).to(frozen.known)
        return whole, frozen, theta

    def _left_by_mesh(
        self, mean: PlateModel, theta: Float[Tensor, " n"]
    ) -> Float[Tensor, "n_left n_basis n_basis"] | None:
        """What may be left of what taking the mesh error off anew has made of each mode, and of each two close ones."""
        correction, settings = self.model.assembly.correction, self.reference.settings
        if self.anew is None or correction is None:
            return None
        before = on_mesh(mean, mean.assembly.corrected(correction))
        system, other = (one.assembly.system(*one.plan(theta)) for one in (mean, before))
        value, shape = solve_modes(system.stiffness, system.mass)
        n_mode = len(self.reference.eigenvalue)
        value, shape = value[:n_mode], shape[:, :n_mode]
        change = settings.mesh * (shape.mT @ (system.stiffness - other.stiffness) @ shape)
        near = (value - value[:, None]).abs() <= settings.near * torch.maximum(value, value[:, None])
        first, second = torch.nonzero(torch.triu(near)).unbind(-1)
        load = (system.mass @ shape).mT
        one_way = change[first, second, None, None] * load[first, :, None] * load[second, None, :]
        return torch.where((first == second)[:, None, None], one_way, one_way + one_way.mT)

    def marginal(self, one: Hypothesis, theta: Float[Tensor, " n"]) -> Marginal:
        """Noise and nuisances of this test, and what the reference leaves open, beside a member."""
        target = self.builder.target
        plain = target.marginal(one.reduced, theta, one.about, specimen=False)
        model = as_the_specimen(one.whole, one.reduced)
        values = {**one.reduced.as_dict(theta)}
        everything = torch.tensor([values[name] for name in model.names]).to(theta)
        columns = all_columns(self.builder, model, one.specimens, everything, one.told)
        known = columns @ one.half.to(columns)
        if one.changed:
            known = torch.cat([self._shapes(one, theta, columns), known], dim=-1)
        if one.by_mesh is not None:
            gain = target.gain_of(one.reduced, theta) if target.gain_is_unknown else 1.0
            left = matrix_columns(one.reduced, theta, target.frequency, one.by_mesh, torch.zeros_like(one.by_mesh))
            known = torch.cat([gain * left.movedim(0, -1), known], dim=-1)
        return plain.beside(known, GROUP, one.drift)

    def _shapes(
        self, one: Hypothesis, theta: Float[Tensor, " n"], columns: Complex[Tensor, "n_f n_response n_reference n_all"]
    ) -> Complex[Tensor, "n_f n_response n_reference n_mode"]:
        """What a change does to each mode is as uncertain as the mode's shape is."""
        reference = self.reference
        before, n_mode = reference.eigenvalue, len(reference.eigenvalue)
        after = eigenvalues(one.mean, theta)[:n_mode]
        moved = 0.5 * (after.clamp(min=1.0) / before.clamp(min=1.0)).log()
        settings, first = reference.settings, len(one.told) + reference.n_section
        std = settings.shape * reference.missed * moved.abs() / settings.mode_stiffness
        return columns[..., first : first + n_mode] * std.to(columns)

    def moved(
        self, one: Hypothesis, channels: OfChannels | None, drift: Float[Tensor, " n_drift"] | None = None
    ) -> Hypothesis:
        """The same with sensors and hits where they were found, and the plate drifted as it was.

        Args:
            one: the hypothesis.
            channels: what each has of its own; None for nothing.
            drift: since the reference, in standard deviations; None for none.
        """
        if channels is None and drift is None:
            return one
        about, shift = None, self.reference.shift
        if channels is not None:
            nothing = one.frozen.known.new_zeros(0)
            about = Found(nothing, nothing[:, None], channels)
        if drift is not None:
            shift = shift + (one.half[:, -len(drift) :] @ drift)[-len(shift) :]
        return one._replace(reduced=one.specimens.at(shift, channels), about=about, drift=drift)


def as_the_specimen(model: PlateModel, specimen: PlateModel) -> PlateModel:
    """A model in a specimen's basis, its dampings, sensors and hits as that one's are."""
    found = on_mesh(model, specimen.assembly).with_damping_factors(specimen.damping_factor)
    off = specimen.off_marks
    return found if off is None else found.with_places_off(off.response, off.reference, off.support)
