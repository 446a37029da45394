"""The plate on one mesh, given or corrected, with whatever effects; and bases that are small and right.

All hypotheses share the modes of the fitted given model. What moves shapes far (an edge that is held, another grain)
brings the modes of some plates of its own; and where a refit ends, the modes of that very plate join, so that its
natural frequencies are those of all dofs.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from scipy.sparse import csr_array
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.held_edges import held_again, held_edges, on_springs
from torchplate.diagnosis.model_builder import with_candidate, working_mesh
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.natural import Natural
from torchplate.diagnosis.table.settings import TableSettings
from torchplate.model import Modes, PlateModel, SparseModel, extrapolate, on_mesh
from torchplate.plate import Assembly

MeshKind = Literal["given", "corrected"]
# Columns shorter than this part of the longest say nothing new: rounding.
INDEPENDENT = 1e-10


class Plates:
    """The plate on one mesh.

    Args:
        model: the given one; its searched parameters are fitted.
        evidence: the table.
        mesh: the given mesh, or one finer whose error is extrapolated.
        settings: constants.
        n_element: least number of elements of the corrected mesh.
    """

    def __init__(
        self,
        model: PlateModel,
        evidence: TableEvidence,
        mesh: MeshKind,
        settings: TableSettings,
        n_element: int,
    ) -> None:
        self.kind: MeshKind = mesh
        self.settings = settings
        self.held = held_edges(model)
        sprung = on_springs(model)
        self.top = 1.1 * float(evidence.frequency.max())
        self.n_mode = int(evidence.mode.max()) + 1
        self.mode = evidence.mode
        fine = working_mesh(sprung.mesh, n_element)
        self._assembly = Assembly(sprung.mesh if mesh == "given" else fine, dense=False).to(model.known)
        self._finer: Assembly | None = None
        self.model = on_mesh(sprung, self._assembly)
        self.evidence = evidence
        self.n_evaluation = 0
        if mesh == "corrected":
            self.at(model.space.to_si(model.known.new_full((len(model.names),), 0.5)))

    def at(self, theta: Float[Tensor, " n_parameter"]) -> None:
        """Take the mesh error off where the given model is now, and begin a basis there."""
        if self.kind == "corrected":
            self.model, self.evidence = self.anew(self.model, theta)
        n_mode = int(self.settings.basis_times * self.n_mode) + self.settings.basis_more
        self._modes = self._of(self.model, theta, n_mode).shape

    def anew(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> tuple[PlateModel, TableEvidence]:
        """A model whose own mesh error is taken off where it is now, and the table with what stays of it."""
        if self._finer is None:
            finer = dataclasses.replace(self.model.mesh, refine=2 * self.model.mesh.refine)
            self._finer = Assembly(finer, dense=False).to(self.model.known)
        found = extrapolate(on_mesh(model, self._assembly), self.top, theta, self._finer)
        error = torch.zeros(self.n_mode).to(found.error)
        count = min(self.n_mode, len(found.error))
        error[:count] = found.error[:count].abs()
        left = self.settings.mesh_part * error[self.mode] + self.settings.mesh_least
        return found.model, self.evidence.on_mesh(left * self.evidence.frequency)

    @classmethod
    def corrected(cls, model: PlateModel, evidence: TableEvidence, settings: TableSettings) -> "Plates":
        """On the coarsest mesh that leaves little beside the scatter."""
        for n_element in settings.n_element:
            found = cls(model, evidence, "corrected", settings, n_element)
            left = (found.evidence.std.square() - evidence.std.square()).clamp(min=0).sqrt() / evidence.std
            if float(left.max()) <= settings.little:
                break
        return found

    def _of(self, model: PlateModel, theta: Tensor, n_mode: int) -> Modes:
        """The lowest modes of one member in all dofs."""
        self.n_evaluation += 1
        sparse = SparseModel(model, theta)
        size = model.assembly.size
        modes = sparse.modes(min(n_mode, size), 0.0, dense=n_mode > size // 3)
        return Modes(modes.eigenvalue[:n_mode], modes.shape[:, :n_mode])

    def with_effects(self, candidates: Sequence[Candidate], labels: Sequence[str]) -> PlateModel:
        """The given model with effects more, in all dofs."""
        model = self.model
        for label, candidate in zip(labels, candidates, strict=True):
            model = with_candidate(model, label, candidate)
        return model

    def reduced(self, model: PlateModel, extra: Sequence[Float[Tensor, "n_free n"]] = ()) -> Natural:
        """A model in the shared modes and some more."""
        stack = torch.cat([self._modes, *extra], dim=-1)
        if extra:
            middle = SparseModel(model, model.space.to_si(model.known.new_full((len(model.names),), 0.5)))
            gram = stack.mT @ middle.times_mass(stack)
            size = gram.diagonal().sqrt()
            strength, direction = torch.linalg.eigh(gram / size / size[:, None])
            kept = strength > INDEPENDENT * strength[-1]
            stack = (stack / size) @ direction[:, kept] / strength[kept].sqrt()
        theta = model.space.to_si(model.known.new_full((len(model.names),), 0.5))
        section = model.plan(theta).section
        by_element = any(part is not None and part.shape[-1] > 1 for part in section)
        correction, patterns = model.assembly.correction, self._patterns
        assembly = Assembly(model.mesh, stack, by_element, correction, of_mesh=patterns).to(model.known)
        return Natural(on_mesh(model, assembly), self.mode)

    @functools.cached_property
    def _patterns(self) -> list[csr_array]:
        """What every basis on this mesh is made from."""
        return self._assembly.patterns_everywhere()

    def solved(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Modes:
        """Modes of one plate in all dofs: those of the table, and the few above that it brings into a basis."""
        return self._of(model, theta, self.n_mode + self.settings.basis_further)

    def exactly(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Float[Tensor, " n_mode"]:
        """Natural frequencies of one member in all dofs [Hz]."""
        return self._of(model, theta, self.n_mode).frequency[self.mode]

    def finished(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> PlateModel:
        """A model of numbers, what did not yield held as in the given one."""
        numbers = model.replaced(known=model.as_dict(theta), searched={})
        again = held_again(numbers, self.held)
        if again is numbers or self.kind == "given":
            return again
        return extrapolate(again, self.top).model
