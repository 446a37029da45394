"""Where models are built and evaluated: one mesh for all, its error taken off, and bases that are right where used.

Every hypothesis is the baseline with one more effect. Those that are screened share one basis, of the baseline; those
that are refitted get a basis of their own, from the modes where they start and where they are, built anew as they move
unless the last one holds them too.
"""

import copy
import dataclasses
import math
from collections import deque
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.held_edges import held_again, held_edges, on_springs
from torchplate.diagnosis.lines import about_peaks
from torchplate.diagnosis.settings import Fineness
from torchplate.diagnosis.target import FrfTarget
from torchplate.discrepancy import UNIFORM, Found, n_terms, section_off
from torchplate.model import Extrapolated, PlateModel, extrapolate, on_mesh, ritz_basis, shares_basis
from torchplate.plate import Assembly, Local, Mesh, Plan


class OfPlate(NamedTuple):
    """A basis, and what it was made of.

    Attributes:
        basis: its columns.
        model: in all dofs.
        plan: the member; None where it was made of several.
        off_marks: whether it holds what is read beside the marks.
        shift: how far the section of that plate is off, in standard deviations of each term.
    """

    basis: Float[Tensor, "n_free n_basis"]
    model: PlateModel
    plan: Plan | None
    off_marks: bool
    shift: Float[Tensor, " n_term"]

    def is_near(self, shift: Float[Tensor, " n_term"], most: float) -> bool:
        """Whether a section is off by nearly as much as the one it was made of; where none wanders, by nothing."""
        if len(shift) != len(self.shift):
            return not bool(shift.any()) and not bool(self.shift.any())
        return float((self.shift - shift).norm()) <= most

    def holds(self, model: PlateModel, plan: Plan, n_mode: int, off_marks: bool) -> bool:
        """Whether it holds another plate too.

        Args:
            model: in all dofs.
            plan: the member.
            n_mode: modes in the band.
            off_marks: whether it is to hold what is read beside the marks.
        """
        own = self.model
        alike = own.assembly.correction is model.assembly.correction and own.mesh == model.mesh
        channels = (own.response, own.reference, own.kind) == (model.response, model.reference, model.kind)
        if self.plan is None or not alike or not channels or off_marks != self.off_marks:
            return False
        return shares_basis(model, self.plan, plan, n_mode)


class OfKind(NamedTuple):
    """A mesh error that was taken off, and the kind of plate that has it.

    Attributes:
        found: the plate without it.
        kind: what its modes hang on beside the size of its rigidity; see `kind_of`.
    """

    found: Extrapolated
    kind: Float[Tensor, "#n_element n_entry"]

    def holds(self, kind: Float[Tensor, "#n_element n_entry"], shift: float, top: float) -> bool:
        """Whether another plate has nearly the same error; what kinds differ by changes it by as much of itself.

        Where modes of two meshes could not be told for each other up to the end of the band, as those of some plates
        with a hole, nothing was found of the error of the others. Kinds that differ by rounding are one.

        Args:
            kind: of that plate.
            shift: by how much of itself a natural frequency may be off [-].
            top: end of the band [Hz].
        """
        apart = float((kind - self.kind).square().sum(-1).mean().sqrt())
        reaches = len(self.found.frequency) > 0 and float(self.found.frequency[-1]) >= top
        return apart <= math.sqrt(torch.finfo(kind.dtype).eps) or (
            reaches and apart * float(self.found.error.abs().amax()) <= shift
        )


def kind_of(plan: Plan) -> Float[Tensor, "#n_element n_entry"]:
    """Rigidities of elements over unit sides, over the norm of their mean [-]: plates of one kind share their modes.

    D_ij of κ_x, κ_y and 2 κ_xy goes with 1/(L_i L_j) of these over a square.
    """
    x, y = plan.geometry
    side = torch.stack([x.square(), y.square(), x * y]).to(plan.section.rigidity)
    found = (plan.section.rigidity / (side[:, None] * side)).flatten(-2)
    return found / found.mean(-2).norm()


class ModelBuilder:
    """Builds models of one plate and counts what they cost.

    Args:
        model: the given one.
        target: what it is held against.
        as_given: on the mesh as it is, with its error; else on a finer one whose error is taken off, held edges on
            springs.
        fineness: of that mesh; left out, that where effects are looked for.
        even: bases are those of even plates, whatever is known of a specimen: where two tests of one are compared, what
            they leave of it is then the same in both.
    """

    def __init__(
        self,
        model: PlateModel,
        target: FrfTarget,
        as_given: bool = False,
        fineness: Fineness | None = None,
        even: bool = False,
    ) -> None:
        self.target, self.as_given, self.even = target, as_given, even
        self.fineness = fineness or target.settings.meshes.searching
        self._count = [0]
        self.held, self.plain = held_edges(model), model
        model = model if as_given else on_springs(model)
        self.mesh = model.mesh if as_given else working_mesh(model.mesh, self.fineness.least)
        self._assembly = Assembly(self.mesh, dense=False).to(model.known)
        self._finer: Assembly | None = None
        self._known: deque[OfKind] = deque(maxlen=target.settings.meshes.n_kind)
        self._as_fine: dict[Fineness, ModelBuilder] = {}
        # The last basis of each margin, which may hold the next plate too, or from which its own is found.
        self._last: dict[float, OfPlate] = {}
        self.top = float(target.frequency.max())
        self.given = self.adopt(model)

    @property
    def n_evaluation(self) -> int:
        """FRFs of members evaluated so far, for whatever target."""
        return self._count[0]

    def count(self, n: int) -> None:
        """So many more."""
        self._count[0] += n

    def adopt(self, model: PlateModel) -> PlateModel:
        """A model on the working mesh, in all dofs."""
        return on_mesh(model, self._assembly)

    def corrected(self, model: PlateModel, theta: Float[Tensor, " n_parameter"], anew: bool = False) -> Extrapolated:
        """A model whose mesh error is taken off, and natural frequencies with their relative errors.

        What the stiffness of a plate lacks on a mesh goes with its rigidity, whatever is attached to it: it is found
        once for all plates of a kind, without what sits at places, so that none has in it what a mesh gives under the
        mass or the support of another. With Poisson's ratio, the grain, or the ratio of the sides the modes change, and
        it with them, and with a section that differs from place to place: what stands beside a patch is compared with
        the patch alone. Edges that are held on springs are another matter.

        Args:
            model: in all dofs.
            theta: its searched parameters.
            anew: of this very model, which others are not to share.
        """
        plain = on_mesh(model, self._assembly)
        if self.as_given:
            nothing = theta.new_zeros(0)
            return Extrapolated(plain, nothing, nothing)
        if anew:
            return self._extrapolated(plain, theta)
        kind = kind_of(plain.plan(theta))
        holding = (index for index, one in enumerate(self._known) if one.holds(kind, self.fineness.shift, self.top))
        if self.held or (index := next(holding, None)) is None:
            known = OfKind(self._extrapolated(*self._without_attached(plain, theta)), kind)
        else:
            known = self._known[index]
            del self._known[index]
        # The one that was asked for last goes last.
        self._known.append(known)
        return known.found._replace(model=on_mesh(plain, known.found.model.assembly))

    def _without_attached(self, model: PlateModel, theta: Tensor) -> tuple[PlateModel, Tensor]:
        """A plate and its parameters without what effects put at places, and without what changes that."""
        value, terms, own = model.values(theta), list[Local](), {}
        for label, effect in model.effects.items():
            after = effect.attached(model.mesh, terms, value[label])
            changes = any(one is not other for one, other in zip(terms, after, strict=False))
            if effect.local(model.mesh, value[label]) is None and not changes:
                own[label] = effect
            terms = list(after)
        if self.held or len(own) == len(model.effects):
            return model, theta
        bare = model.replaced(effects=own)
        return bare, theta[[model.names.index(name) for name in bare.names]]

    def is_right_at(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> bool:
        """Whether the mesh error that was taken off a model is that of its plate with these parameters, too.

        Args:
            model: whose mesh error was taken off by this builder.
            theta: other parameters of it.
        """
        if self.as_given or self.held:
            return True
        kind, own = kind_of(model.plan(theta)), model.assembly
        return any(
            one.found.model.assembly is own and one.holds(kind, self.fineness.shift, self.top) for one in self._known
        )

    def _extrapolated(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Extrapolated:
        """From the working mesh and the one twice as fine."""
        if self._finer is None:
            finer = dataclasses.replace(self.mesh, refine=2 * self.mesh.refine)
            self._finer = Assembly(finer, dense=False).to(model.known)
        return extrapolate(model, self.top or None, theta, self._finer, self.target.settings.meshes.corrected)

    def finished(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> PlateModel:
        """A model with its searched parameters at these values, and what did not yield held as in the given one."""
        numbers = model.replaced(known=model.as_dict(theta), searched={})
        again = held_again(numbers, self.held)
        return numbers if again is numbers else extrapolate(again, self.top).model

    def reduced(
        self,
        model: PlateModel,
        members: Float[Tensor, "n_member n_parameter"],
        by_element: bool | None = None,
        margin: float | None = None,
        about: Found | None = None,
    ) -> PlateModel:
        """A model in the modes of some of its members, and the static residual of the higher ones.

        Args:
            model: in all dofs.
            members: whose modes these are.
            by_element: whether elements will differ; left out, where they do.
            margin: modes kept, in multiples of the band's end [-]; left out, that of the settings.
            about: the specimen, as far as it is known: the modes are then those of its section.
        """
        margin = margin or self.target.settings.meshes.margin
        off, last = self.target.imperfections.std("position_std") > 0, self._last.get(margin)
        shift = self._of_section(about)
        if last is not None and last.is_near(shift, self.target.settings.meshes.same_section):
            shift = last.shift
        given = model
        if bool(shift.any()):
            model = model.with_section_off(section_off(self.target.wandering, shift))
        plan = model.plan(members[0]) if len(members) == 1 else None
        if last is None or plan is None or not last.holds(model, plan, self.target.n_mode, off):
            top, near = torch.tensor([self.top]).to(model.known), None if last is None else last.basis
            last = OfPlate(
                ritz_basis(model, members, top, 0, margin, off_marks=off, near=near), model, plan, off, shift
            )
            self._last[margin] = last
        model, basis = given, last.basis
        if by_element is None:
            return model.projected(basis)
        return on_mesh(model, Assembly(self.mesh, basis, by_element, model.assembly.correction))

    def _of_section(self, about: Found | None) -> Float[Tensor, " n_term"]:
        """How far a specimen's section is off, in standard deviations; zeros where nothing is known of it."""
        wandering = self.target.wandering
        found = self.given.known.new_zeros(0 if wandering == UNIFORM else n_terms(wandering))
        if about is not None and not self.even:
            n = min(len(found), len(about.shift))
            found[:n] = about.shift[:n]
        return found

    def predict(
        self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"], level: int | None = None
    ) -> Tensor:
        """What a model says of the target; at a level, of what is looked at there."""
        self.count(theta.shape[:-1].numel())
        return self.target.predict(model, theta, level)

    def thinned(self, found: Extrapolated) -> "ModelBuilder":
        """The same beside so many lines as the target says anything by.

        Args:
            found: a model of this builder, with natural frequencies.
        """
        return self.against(about_peaks(self.target, int((found.frequency <= self.top).sum())))

    def natural_frequencies(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Float[Tensor, " n_mode"]:
        """Of a model whose mesh error is taken off, up to the band's end and one beyond [Hz].

        Args:
            model: in all dofs.
            theta: its searched parameters.
        """
        reduced = self.reduced(self.corrected(model, theta).model, theta[None])
        found = reduced.modes(theta[None], check=False).frequency[0]
        return found[: int((found <= self.top).sum()) + 1]

    def expecting(self, found: Extrapolated, beside: Extrapolated | None = None) -> "ModelBuilder":
        """The same, its target weighed by what this mesh leaves of its error.

        Args:
            found: a model of this builder, with natural frequencies and their errors.
            beside: with what sits at places, and the part of natural frequencies that is left for that alone.
        """
        shift = self.fineness.shift + self.fineness.part * self._at_lines(found)
        if beside is not None:
            shift = shift + self._at_lines(beside)
        in_band = int((found.frequency <= self.top).sum())
        n_x, n_y = self.mesh.cells
        side = max(self.mesh.length_x / n_x, self.mesh.length_y / n_y)
        place = self.fineness.place * side
        return self.against(self.target.with_mesh_error(shift, self.fineness.shape, in_band, place))

    def _at_lines(self, found: Extrapolated) -> Float[Tensor, " n_frequency"]:
        """The greatest error of natural frequencies up to each line, relative to them [-]."""
        worst = found.error.abs().cummax(0).values
        line = self.target.frequency.to(found.frequency)
        return worst[torch.searchsorted(found.frequency.contiguous(), line.contiguous()).clamp(max=len(worst) - 1)]

    def as_fine_as(self, fineness: Fineness) -> "ModelBuilder":
        """The same on another mesh whose error is taken off, made once; what it costs is counted here."""
        if fineness == self.fineness:
            return self
        if fineness not in self._as_fine:
            self._as_fine[fineness] = ModelBuilder(self.plain, self.target, fineness=fineness, even=self.even)
            self._as_fine[fineness]._count = self._count
        return self._as_fine[fineness].against(self.target)

    def against(self, target: FrfTarget) -> "ModelBuilder":
        """The same beside another target; meshes are shared."""
        twin = copy.copy(self)
        twin.target = target
        return twin


def working_mesh(mesh: Mesh, least: int) -> Mesh:
    """The mesh, split so that it has so many elements at least."""
    split = max(1, math.ceil(math.sqrt(least / mesh.n_element)))
    return dataclasses.replace(mesh, refine=mesh.refine * split)


def with_candidate(model: PlateModel, label: str, candidate: Candidate) -> PlateModel:
    """The model with one more effect, whose parameters are searched; without the one that it stands for."""
    if candidate.replaces:
        model = _without(model, candidate.replaces)
    more = {f"{label}.{key}": interval for key, interval in candidate.searched.items()}
    idle = {f"{label}.{key}": candidate.neutral[key] for key in candidate.idle}
    wider = model.searched | {name: beside for name, (_, beside) in candidate.widened.items()}
    effects = {**model.effects, label: candidate.effect}
    return model.replaced(effects=effects, known=model.known_values | idle, searched=wider | more)


def without_candidate(model: PlateModel, label: str, candidate: Candidate) -> PlateModel:
    """The model with one effect less; with the one that it stood for."""
    model = _without(model, label)
    if candidate.widened:
        narrow = {name: alone for name, (alone, _) in candidate.widened.items()}
        model = model.replaced(searched=model.searched | narrow)
    if not candidate.replaces:
        return model
    back = {f"{candidate.replaces}.{name}": value for name, value in candidate.neutral.items()}
    effects = {**model.effects, candidate.replaces: candidate.effect}
    return model.replaced(effects=effects, known=model.known_values | back)


def _without(model: PlateModel, label: str) -> PlateModel:
    return model.replaced(effects={key: effect for key, effect in model.effects.items() if key != label})
