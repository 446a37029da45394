"""The same plate with other effects or numbers, in a basis, or solved otherwise."""

import copy
from collections.abc import Callable, Mapping
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects import Effect, Searched
from torchplate.model.declared_plate import DeclaredPlate
from torchplate.model.off_marks import OffMarks
from torchplate.model.receptance.shared_modes import SharedModes
from torchplate.plate import Assembly, Mesh, Section

# Greatest error of an FRF in relative norm for which a search is done in single precision; least squares finish it.
SINGLE_TOLERANCE = 1e-4

# The class that is asked for another of its kind.
Kind = TypeVar("Kind", bound="PlateVariants")


class PlateVariants(DeclaredPlate):
    """A declared plate, and others like it; what they hold is shared. See `DeclaredPlate` for what it takes."""

    def _twin(self: Kind) -> Kind:
        """The same model, of which attributes can be changed; what they hold is shared."""
        twin = copy.copy(self)
        twin._modules = dict(self._modules)
        return twin

    def replaced(
        self: Kind,
        *,
        effects: Mapping[str, Effect] | None = None,
        known: Mapping[str, float] | None = None,
        searched: Mapping[str, Searched] | None = None,
    ) -> Kind:
        """A model of the same mesh, assembly and channels, and of other effects or numbers.

        What is left out stays as it is, dampings that are off their law too; of effects that are no longer there it
        goes. An effect that has split the mesh goes too, since the mesh is already what it has made of it.

        Args:
            effects: label → effect.
            known: "label.parameter" → value in SI units.
            searched: "label.parameter" → interval; what is also known is searched.

        Raises:
            ValueError: as for a new model.
        """
        every = self.effects if effects is None else effects
        kept = {label: effect for label, effect in every.items() if effect.discretise(self.mesh) is self.mesh}
        parameters = {f"{label}.{name}" for label, effect in kept.items() for name in effect.parameters}
        own = {key: value for key, value in self.known_values.items() if key in parameters}
        box = {key: interval for key, interval in self.searched.items() if key in parameters}
        found = type(self)(
            self.mesh,
            kept,
            own if known is None else known,
            box if searched is None else searched,
            self.response,
            self.reference,
            self.kind,
            self.memory,
            self.assembly,
        ).to(self.known.device)
        found.damping_factor, found.couples_modes = self.damping_factor, self.couples_modes
        found.off_marks, found.section_off = self.off_marks, self.section_off
        return found

    def projected(
        self: Kind,
        basis: Float[Tensor, "n_free n_basis"],
        shared_modes: SharedModes | None = None,
        matrices: bool = True,
    ) -> Kind:
        """The same model with all matrices projected on a basis over the free dofs; see `reduced_basis`.

        Args:
            basis: its columns.
            shared_modes: of all members, if they have any; the columns are then these modes.
            matrices: whether natural frequencies or gradients in matrices will be wanted, too, beside the FRFs.
        """
        twin = self._twin()
        section = self.plan(self.space.to_si(torch.full((len(self.names),), 0.5).to(self.known))).section
        by_element = any(part is not None and part.shape[-1] > 1 for part in section)
        # On all dofs, members that share their modes need no matrix any more.
        dense = shared_modes is None or (matrices and basis.shape[0] != basis.shape[1])
        twin.assembly = Assembly(self.mesh, basis.cpu(), by_element and dense, self.assembly.correction, dense).to(
            basis
        )
        twin.shared_modes = shared_modes
        return twin

    def without_coupling(self: Kind) -> Kind:
        """The same model, where a loss in a part of the plate damps each mode and couples none.

        Of ΦᵀHΦ the diagonal alone is kept (Lord Rayleigh, The Theory of Sound, 2nd ed. 1894, section 102): off by the
        square of the loss factor over how far modes are apart, and several times as fast. For values alone: its
        gradients are those of the modes held as they are.
        """
        twin = self._twin()
        twin.couples_modes = False
        return twin

    def with_damping_factors(self: Kind, factor: Float[Tensor, " n_mode"] | None) -> Kind:
        """The same model, each mode's damping a number of times what its law makes of it: no plate obeys one exactly.

        Gradients hold the modes to which that is added as they are; differences see them turn, too.

        Args:
            factor: of the lowest modes [-], ≥ 0; modes beyond keep theirs. None where all obey the law.

        Raises:
            ValueError: if the model is in a basis of shared modes, which takes one law for all.
        """
        if self.shared_modes is not None and factor is not None:
            raise ValueError(
                "Expected a model with matrices of its own, got one in a basis of shared modes. Give the model before "
                "`reduce`, or in the basis of `ritz_basis`."
            )
        twin = self._twin()
        twin.damping_factor = None if factor is None else factor.to(self.known)
        return twin

    def with_section_off(self: Kind, found: Callable[[Mesh, Section], Section] | None) -> Kind:
        """The same plate, its section so far off from place to place: what any of its effects make of it, and more.

        Args:
            found: what the elements of a mesh are made of, where effects say that they are made of this; None where
                they are right.
        """
        twin = self._twin()
        twin.section_off = found
        return twin

    def with_places_off(
        self: Kind,
        response: Float[Tensor, "n_response 2"] | None,
        reference: Float[Tensor, "n_reference 2"] | None = None,
        support: Float[Tensor, "n_support 2"] | None = None,
    ) -> Kind:
        """The same model, whose own sensors and hits are off their marks; other points that are asked for are not.

        A point mass at a sensor's mark is the sensor's own and is off with it.

        Args:
            response: by how much, relative to the sides [-]; None where all are on their marks.
            reference: likewise; None where the plate is shaken by its edges.
            support: likewise of the first places of the `support_spring`s; None where all are on their marks.
        """
        twin = self._twin()
        if response is None:
            twin.off_marks = None
        else:
            off = None if reference is None else reference.to(self.known)
            hung = None if support is None else support.to(self.known)
            twin.off_marks = OffMarks(response.to(self.known), off, self.carried(), hung)
        return twin

    def in_single_precision(self: Kind) -> Kind:
        """The same model for searches: under `torch.no_grad` its FRFs are put together in single precision.

        Where all members share their modes (`reduce` tells) and no place is searched it is half as fast again, and off
        by 1e-6 to 1e-5 of an FRF's norm. Strong springs and masses take more digits: `reduce` measures what is left,
        `shared_modes.single_error`, and beyond `SINGLE_TOLERANCE` the model stays in double precision, as it does
        where members share no modes. How far a line is from a pole is found in double precision all the same, and
        derivatives never leave it.
        """
        twin = self._twin()
        twin.in_single = self.shared_modes is not None and self.shared_modes.single_error <= SINGLE_TOLERANCE
        return twin
