"""From Section and Local to the matrices of the model, for a whole population at once.

Elements meet by index arithmetic (one scatter), never in a loop. A plate of sides Lx, Ly with rigidity D and areal
mass m is the unit square with rigidity Lx Ly T D T, T = diag(1/Lx², 1/Ly², 1/(Lx Ly)), and areal mass m Lx Ly: so the
geometry is just one more coefficient, and where the section is the same everywhere K is a sum of six fixed matrices.
"""

import copy
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from torch import Tensor, nn

from torchplate.plate import element
from torchplate.plate.added_mass import AddedMass
from torchplate.plate.coefficients import (
    STRAIGHT,
    mass_coefficient,
    stiffness_coefficient,
    uneven_coefficient,
    uneven_mass_coefficient,
)
from torchplate.plate.correction import Correction, Unevenness
from torchplate.plate.mesh import Mesh
from torchplate.plate.rows import times
from torchplate.plate.section import Geometry, Local, Proportional, Section, Sprung, System, concatenate
from torchplate.plate.transforms import REMEMBERED, stays, transformed

# Fixed matrices, of a uniform plate and of projected elements, are kept up to these sizes; beyond they are made anew.
UNIFORM_BYTES, ELEMENT_BYTES = 256 * 2**20, 512 * 2**20


class Assembly(nn.Module):
    """Assembles on one mesh; held dofs are left out of every result.

    Args:
        mesh: the mesh.
        basis: columns over the free dofs; with it, all results are those of the projection basisᵀ (·) basis.
        by_element: whether elements will differ. Each is then projected once, where that fits.
        correction: what the stiffness of a finer mesh would add; see `model.extrapolation`.
        dense: whether matrices will be wanted often; False where only sparse ones, projections and rows are.
        of_mesh: `patterns_everywhere` of this mesh, where many bases share it; left out, they are made.
    """

    index: Tensor
    free: Tensor
    position: Tensor
    pattern: Tensor
    mass_pattern: Tensor
    uneven_pattern: Tensor
    uneven_mass_pattern: Tensor
    uniform: Tensor | None
    elements: Tensor | None
    element_masses: Tensor | None
    mirror: Tensor | None
    basis: Tensor | None
    seen: Tensor | None
    everywhere: Tensor | None
    lacking: Tensor | None
    losing: Tensor | None
    unevenness: Unevenness | None = None

    def __init__(
        self,
        mesh: Mesh,
        basis: Float[Tensor, "n_free n_basis"] | None = None,
        by_element: bool = False,
        correction: "Correction | None" = None,
        dense: bool = True,
        of_mesh: Sequence[csr_array] | None = None,
    ) -> None:
        super().__init__()
        self.mesh = mesh
        self._known_rows: dict[int, tuple[Tensor, Tensor, Tensor]] = {}
        self._known_added: dict[tuple[int, int], tuple[AddedMass, Tensor | None, Tensor]] = {}
        dof = mesh.element_dof
        pattern, mass_pattern = element.patterns(1 / mesh.cells[0], 1 / mesh.cells[1])
        free = mesh.free_dof
        # Held dofs share one more row and column, which is cut off after the scatter.
        position = torch.full((mesh.n_dof,), len(free), dtype=torch.int64)
        position[free] = torch.arange(len(free))
        row = position[dof]
        self.register_buffer("free", free, persistent=False)
        self.register_buffer("position", row, persistent=False)
        self.register_buffer("index", (row[:, :, None] * (len(free) + 1) + row[:, None, :]).flatten(), persistent=False)
        self.register_buffer("pattern", pattern, persistent=False)
        self.register_buffer("mass_pattern", mass_pattern, persistent=False)
        uneven = element.uneven_patterns(1 / mesh.cells[0], 1 / mesh.cells[1])
        self.register_buffer("uneven_pattern", uneven, persistent=False)
        uneven_mass = element.uneven_mass_pattern(1 / mesh.cells[0], 1 / mesh.cells[1])
        self.register_buffer("uneven_mass_pattern", uneven_mass, persistent=False)
        self.register_buffer("basis", basis, persistent=False)
        self.register_buffer("uniform", None, persistent=False)
        self.register_buffer("elements", None, persistent=False)
        self.register_buffer("element_masses", None, persistent=False)
        self.register_buffer("mirror", None, persistent=False)
        if basis is not None:
            if dense:
                self.uniform = torch.stack([self._projected(one) for one in of_mesh or self.patterns_everywhere()])
            if by_element and 7 * 8 * mesh.n_element * basis.shape[-1] ** 2 <= 2 * ELEMENT_BYTES:
                self._keep_elements()
        elif dense and 7 * 8 * len(free) ** 2 <= UNIFORM_BYTES:
            everywhere = torch.cat([pattern, mass_pattern[None]])[:, None].expand(-1, mesh.n_element, -1, -1)
            self.uniform = self._scatter(everywhere)
        self._correct(correction)

    def _keep_elements(self) -> None:
        """What each element is in the basis, for each pattern: one half, since all are symmetric."""
        rows = self.element_rows()
        upper = torch.triu_indices(self.size, self.size, device=rows.device)
        position = torch.arange(upper.shape[1], device=rows.device)
        self.mirror = torch.zeros(self.size, self.size, dtype=torch.int64, device=rows.device)
        self.mirror[upper[0], upper[1]] = position
        self.mirror[upper[1], upper[0]] = position
        half = upper[0] * self.size + upper[1]
        # [n_pattern n_element, n_half], as the products below want them.
        self.elements = rows.new_empty(len(self.pattern) * len(rows), len(half))
        for place, pattern in zip(self.elements.split(len(rows)), self.pattern.to(rows), strict=True):
            torch.index_select((rows.mT @ (pattern @ rows)).flatten(1), 1, half, out=place)
        self.element_masses = (rows.mT @ (self.mass_pattern.to(rows) @ rows)).flatten(1)[:, half]

    def corrected(self, correction: Correction | None) -> "Assembly":
        """The same, with what the stiffness of a finer mesh would add, or without it; matrices are shared."""
        twin = copy.copy(self)
        twin._buffers = dict(self._buffers)
        twin._correct(correction)
        return twin

    def uneven(self, unevenness: Unevenness | None) -> "Assembly":
        """The same for a plate that is not the same everywhere; matrices are shared."""
        twin = copy.copy(self)
        twin._buffers = dict(self._buffers)
        twin.unevenness = unevenness
        return twin

    def _correct(self, correction: "Correction | None") -> None:
        self.correction = correction
        self.register_buffer("seen", self.basis, persistent=False)
        self.register_buffer("everywhere", None, persistent=False)
        self.register_buffer("lacking", None, persistent=False)
        self.register_buffer("losing", None, persistent=False)
        if correction is not None and self.basis is not None:
            rows, middle, shape = (part.to(self.basis) for part in correction[:3])
            rows = rows @ self.basis
            self.seen, self.lacking = self.basis + shape @ rows, rows.mT @ (middle @ rows)
            if correction.loss is not None:
                self.losing = rows.mT @ (correction.loss.to(rows) @ rows)
        if self.seen is not None:
            # What is held does not move.
            self.everywhere = self.seen.new_zeros(self.mesh.n_dof, self.seen.shape[-1])
            self.everywhere[self.free] = self.seen

    @property
    def size(self) -> int:
        """Rows of every matrix: free dofs, or vectors of the basis."""
        return len(self.free) if self.basis is None else self.basis.shape[-1]

    def stiffness(
        self,
        rigidity: Float[Tensor, "*#batch n_element 3 3"],
        geometry: Geometry,
        uneven: Float[Tensor, "*#batch n_element n_pattern"] | None = None,
    ) -> Float[Tensor, "*batch n n"]:
        """Stiffness matrix K [N/m] from the rigidity of the elements [N m], and how it goes over each of them."""
        stiffness = self._bending(rigidity, uneven, geometry)
        if self.unevenness is not None:
            scale = Correction.measure(rigidity, geometry) / self.unevenness.rigidity
            scale = torch.where(self.unevenness.goes_for(rigidity[..., 0, 0]), scale, 0.0)
            stiffness = stiffness + scale[..., None, None] * self.unevenness.stiffness
        if self.correction is None:
            return stiffness
        scale = self.correction.scale(rigidity, geometry)
        return stiffness + scale[..., None, None] * self._between_modes(self.lacking, self.correction.stiffness)

    def lost(
        self,
        lossy_rigidity: Float[Tensor, "*#batch n_element 3 3"],
        geometry: Geometry,
        uneven: Float[Tensor, "*#batch n_element n_pattern"] | None = None,
    ) -> Float[Tensor, "*batch n n"]:
        """What the elements lose H [N/m], from their rigidity times their own loss factors [N m]."""
        lost = self._bending(lossy_rigidity, uneven, geometry)
        if self.unevenness is not None:
            scale = Correction.measure(lossy_rigidity, geometry) / self.unevenness.rigidity
            lost = lost + scale[..., None, None] * self.unevenness.stiffness
        if self.correction is None:
            return lost
        scale, middle = self.correction.lost(lossy_rigidity, geometry)
        known = self.lacking if self.correction.loss is None else self.losing
        return lost + scale[..., None, None] * self._between_modes(known, middle)

    def _bending(
        self,
        rigidity: Float[Tensor, "*#batch n_element 3 3"],
        uneven: Float[Tensor, "*#batch n_element n_pattern"] | None,
        geometry: Geometry,
    ) -> Float[Tensor, "*batch n n"]:
        """Of the elements, each with a rigidity in the mean, and as that goes over it."""
        stiffness = self._assemble(stiffness_coefficient(rigidity, geometry), self.pattern, slice(0, 6))
        if uneven is not None:
            stiffness = stiffness + self._apart(uneven, self._uneven_pattern(uneven))
        return stiffness

    def _uneven_pattern(self, coefficient: Tensor) -> Float[Tensor, "n_pattern 12 12"]:
        """The patterns of these: of the four entries that a plate along its grain has, or of all six."""
        pattern = self.uneven_pattern
        return (pattern if coefficient.shape[-1] == pattern[..., 0, 0].numel() else pattern[STRAIGHT]).flatten(0, 1)

    def _between_modes(self, known: Tensor | None, middle: Tensor) -> Float[Tensor, "n n"]:
        """Rᵀ C R of a correction, as it is known in the basis."""
        if known is not None:
            return known
        assert self.correction is not None
        rows = self.correction.rows.to(self.pattern)
        return rows.mT @ (middle.to(rows) @ rows)

    def mass(
        self,
        areal_mass: Float[Tensor, "*#batch n_element"],
        geometry: Geometry,
        uneven: Float[Tensor, "*#batch n_element 49"] | None = None,
    ) -> Float[Tensor, "*batch n n"]:
        """Consistent mass matrix M [kg] from the mass per area of the elements [kg/m²], and how it goes over each."""
        coefficient = mass_coefficient(areal_mass, geometry)
        mass = self._assemble(coefficient, self.mass_pattern[None], slice(6, 7))
        if uneven is not None:
            mass = mass + self._apart(uneven, self.uneven_mass_pattern)
        if self.unevenness is None:
            return mass
        scale = Unevenness.measure(areal_mass, geometry) / self.unevenness.heavy
        scale = torch.where(self.unevenness.goes_for(areal_mass), scale, 0.0)
        return mass + scale[..., None, None] * self.unevenness.mass

    def rows(self, vector: Float[Tensor, "*batch n_row n_dof"]) -> Float[Tensor, "*batch n_row n"]:
        """Rows over all dofs of the mesh, as rows over those of this assembly."""
        if self.seen is None or not stays(vector):
            return self._rows(vector)
        # The mesh hands out the same tensor for places that stay where they are.
        known = self._known_rows.get(id(vector))
        if known is None or known[0] is not vector or known[1] is not self.seen:
            if len(self._known_rows) >= REMEMBERED:
                self._known_rows.clear()
            known = self._known_rows[id(vector)] = (vector, self.seen, self._rows(vector))
        return known[2]

    def _rows(self, vector: Tensor) -> Tensor:
        if self.everywhere is not None:
            return times(vector, self.everywhere)
        free = vector[..., self.free]
        if self.correction is not None:
            free = free + (free @ self.correction.shape.to(free)) @ self.correction.rows.to(free)
        return free

    def translation_load(
        self,
        areal_mass: Float[Tensor, "*#batch n_element"],
        geometry: Geometry,
        uneven: Float[Tensor, "*#batch n_element 49"] | None = None,
    ) -> Float[Tensor, "*batch n"]:
        """M r for the rigid translation r of the whole plate, held dofs included [kg]: its inertia under the base."""
        rigid = self.mesh.rigid_translation.to(areal_mass)[: element.N_DOF]
        load = mass_coefficient(areal_mass, geometry) * (self.mass_pattern @ rigid)
        if uneven is not None:
            load = load + uneven @ (self.uneven_mass_pattern @ rigid)
        load = load.expand(*load.shape[:-2], self.mesh.n_element, element.N_DOF)
        flat = load.new_zeros(*load.shape[:-2], len(self.free) + 1)
        flat = flat.index_add(-1, self.position.flatten(), load.flatten(-2))[..., :-1]
        return flat if self.basis is None else flat @ self.basis

    def added_mass(self, added: AddedMass) -> Float[Tensor, "n n"]:
        """Rᵀ C R of a mass that is spread over the plate, for a coefficient of 1."""
        key = id(added.rows), id(added.coupling)
        known = self._known_added.get(key)
        if known is not None and known[1] is self.basis and known[2].device == self.pattern.device:
            return known[2]
        rows = self.spread_rows(added)
        found = rows.mT @ (added.coupling.to(rows) @ rows)
        if not transformed() and not torch.is_inference_mode_enabled():
            if len(self._known_added) >= REMEMBERED:
                self._known_added.clear()
            self._known_added[key] = (added, self.basis, found)
        return found

    def spread_rows(self, added: AddedMass) -> Float[Tensor, "n_place n"]:
        """Rows of a mass that is spread over the plate; what a finer mesh would change in them is nothing to it."""
        rows = added.rows.to(self.pattern)[..., self.free]
        return rows if self.basis is None else rows @ self.basis

    def system(
        self,
        section: Section,
        geometry: Geometry,
        terms: Sequence[Local],
        damping: Sequence[Proportional],
        added: Sequence[AddedMass] = (),
    ) -> System:
        """All matrices of the model: the section's, and what local terms and masses that are spread add to them."""
        stiffness = self.stiffness(section.rigidity, geometry, uneven_coefficient(section, section.uneven, geometry))
        mass = self.mass(section.areal_mass, geometry, uneven_mass_coefficient(section, geometry))
        hysteretic = None
        if section.loss_factor is not None:
            uneven = uneven_coefficient(section, section.uneven_loss, geometry)
            hysteretic = self.lost(section.lossy_rigidity, geometry, uneven)
        dashpots, viscous = [stiffness.new_zeros(0, self.size)], [stiffness.new_zeros(0)]
        carriers, hung = [], []
        for term in terms:
            row = self.rows(term.vector)
            if term.mass is not None:
                mass = mass + row.mT @ (term.mass[..., None] * row)
            if term.stiffness is not None:
                stiffness = stiffness + row.mT @ (term.stiffness[..., None] * row)
            if term.viscous is not None:
                dashpots.append(row)
                viscous.append(term.viscous)
            if term.sprung is not None:
                carriers.append(row)
                hung.append(term.sprung)
        for one in added:
            mass = mass + one.coefficient[..., None, None] * self.added_mass(one)
        return System(
            mass,
            stiffness,
            concatenate(dashpots, 2),
            concatenate(viscous, 1),
            hysteretic,
            self.proportional(damping),
            concatenate(carriers, 2) if carriers else None,
            Sprung(*(concatenate(parts, 1) for parts in zip(*hung, strict=True))) if hung else None,
        )

    @staticmethod
    def proportional(damping: Sequence[Proportional]) -> Proportional:
        """Damping in proportion to the whole model, summed over the effects that bring it."""
        return Proportional(*(sum(part) for part in zip(Proportional(), *damping, strict=True)))

    def sparse(
        self, section: Section, geometry: Geometry, terms: Sequence[Local]
    ) -> tuple[csr_array, csr_array, csr_array, csr_array | None]:
        """K, M, the viscous matrix and the elements' own hysteretic matrix of one member, sparse, on the CPU."""
        uneven = uneven_coefficient(section, section.uneven, geometry)
        stiffness = self._sparse_bending(section.rigidity, uneven, geometry)
        mass = self._sparse(mass_coefficient(section.areal_mass, geometry), self.mass_pattern[None])
        if (heavy := uneven_mass_coefficient(section, geometry)) is not None:
            mass = mass + self._sparse(heavy, self.uneven_mass_pattern)
        viscous = csr_array(stiffness.shape)
        hysteretic = None
        if section.loss_factor is not None:
            uneven = uneven_coefficient(section, section.uneven_loss, geometry)
            hysteretic = self._sparse_bending(section.lossy_rigidity, uneven, geometry)
        for term in terms:
            # Without the correction, which would fill the matrices: see `SparseModel.lacking`.
            row = csr_array(term.vector[..., self.free].double().cpu().numpy())
            for name, value in (("mass", term.mass), ("stiffness", term.stiffness), ("viscous", term.viscous)):
                if value is None:
                    continue
                added = row.T @ diags_array(value.double().cpu().numpy()) @ row
                mass = mass + added if name == "mass" else mass
                stiffness = stiffness + added if name == "stiffness" else stiffness
                viscous = viscous + added if name == "viscous" else viscous
        return stiffness, mass, viscous, hysteretic

    def _sparse_bending(self, rigidity: Tensor, uneven: Tensor | None, geometry: Geometry) -> csr_array:
        found = self._sparse(stiffness_coefficient(rigidity, geometry), self.pattern)
        return found if uneven is None else found + self._sparse(uneven, self._uneven_pattern(uneven))

    def _sparse(self, coefficient: Tensor, pattern: Tensor) -> csr_array:
        coefficient = coefficient.expand(self.mesh.n_element, coefficient.shape[-1])
        value = torch.einsum("ek,kpq->epq", coefficient, pattern).flatten().double().cpu().numpy()
        row, column = (part.cpu().numpy() for part in (self.index // self._width, self.index % self._width))
        kept = (row < len(self.free)) & (column < len(self.free))
        size = (len(self.free), len(self.free))
        return coo_array((value[kept], (row[kept], column[kept])), shape=size).tocsr()

    @property
    def _width(self) -> int:
        """Free dofs and the one that stands for all held ones."""
        return len(self.free) + 1

    def _assemble(self, coefficient: Tensor, pattern: Tensor, which: slice) -> Tensor:
        """Σ over elements and patterns; one matrix product where all elements are alike."""
        if coefficient.shape[-2] == 1 and self.uniform is not None:
            flat = self.uniform[which].flatten(1)
            return (coefficient[..., 0, :] @ flat).unflatten(-1, (self.size, self.size))
        coefficient = coefficient.expand(*coefficient.shape[:-2], self.mesh.n_element, coefficient.shape[-1])
        each = self.elements if which.start == 0 else self.element_masses
        if each is None and (self.basis is None or self.uniform is None):
            return self._matrices(coefficient, pattern)
        # What is the same in most elements is one product for all of them: a patch then costs its own elements.
        most = coefficient.median(-2, keepdim=True).values
        found = self._assemble(most, pattern, which)
        apart = coefficient - most
        if each is None:
            return found + self._apart(apart, pattern)
        differs = _differs(apart)
        some = None if differs is None else _few(differs.any(0))
        if some is not None:
            apart = apart[..., some, :]
            each = each.unflatten(0, (-1, self.mesh.n_element))[:, some].flatten(0, 1)
        return found + (apart.mT.flatten(-2) @ each)[..., self.mirror]

    def _apart(self, coefficient: Tensor, pattern: Tensor) -> Tensor:
        """Σ over elements and patterns, where few elements of each member have any."""
        differs = _differs(coefficient)
        some = None if differs is None else _few(differs.any(0))
        if self.basis is None or differs is None or some is not None or 2 * int(differs.sum()) >= differs.numel():
            return self._matrices(coefficient, pattern, some)
        # Patches in different places: each member has its own elements.
        alone = zip(coefficient.flatten(0, -3), differs, strict=True)
        own = torch.stack([self._matrices(one, pattern, torch.nonzero(where).flatten()) for one, where in alone])
        return own.unflatten(0, coefficient.shape[:-2])

    def _matrices(
        self, coefficient: Float[Tensor, "*batch n_element n_pattern"], pattern: Tensor, some: Tensor | None = None
    ) -> Float[Tensor, "*batch n n"]:
        """Σ over patterns and elements, or some of these."""
        if self.basis is None:
            return self._scatter(torch.einsum("...ek,kpq->...epq", coefficient, pattern))
        coefficient = coefficient if some is None else coefficient[..., some, :]
        return self._project(torch.einsum("...ek,kpq->...epq", coefficient, pattern), some)

    def _scatter(self, matrices: Float[Tensor, "*batch n_element 12 12"]) -> Float[Tensor, "*batch n n"]:
        size = self._width
        flat = matrices.new_zeros(*matrices.shape[:-3], size * size)
        # In place: of large meshes a second copy of it takes longer than the sum.
        flat.index_add_(-1, self.index, matrices.flatten(-3))
        return flat.unflatten(-1, (size, size))[..., :-1, :-1]

    def patterns_everywhere(self) -> list[csr_array]:
        """Each pattern of the stiffness, and that of the mass, in every element, sparse."""
        one = torch.ones(1, 1).to(self.pattern)
        return [self._sparse(one, pattern[None]) for pattern in (*self.pattern, self.mass_pattern)]

    def _projected(self, matrix: csr_array) -> Float[Tensor, "n n"]:
        """One of these in the basis: through a sparse matrix, on meshes of any size."""
        assert self.basis is not None
        basis = self.basis.double().cpu().numpy()
        return torch.from_numpy(basis.T @ (matrix @ basis)).to(self.basis)

    def _project(
        self, matrices: Float[Tensor, "*batch n_some 12 12"], some: Int[Tensor, " n_some"] | None = None
    ) -> Float[Tensor, "*batch n n"]:
        rows = self.element_rows(some)
        # All elements in one product, so that no matrix of the basis' size is made for each of them.
        return rows.flatten(0, 1).mT @ (matrices @ rows).flatten(-3, -2)

    def element_rows(self, some: Int[Tensor, " n_some"] | None = None) -> Float[Tensor, "n_some 12 n"]:
        """The basis at the dofs of each element, or of some; zero where they are held."""
        position = self.position if some is None else self.position[some]
        if self.basis is None:
            one = torch.eye(len(self.free) + 1, dtype=self.pattern.dtype, device=self.pattern.device)[:, :-1]
            return one[position]
        return torch.cat([self.basis, self.basis.new_zeros(1, self.size)])[position]


def _differs(coefficient: Float[Tensor, "*batch n_element n_pattern"]) -> Bool[Tensor, "n_member n_element"] | None:
    """The elements of which a coefficient of each member is not zero; None where nobody may look.

    What is zero here and has a derivative does not stay zero.
    """
    if coefficient.requires_grad or transformed():
        return None
    # Several times as fast as `any` of those that are not.
    return coefficient.abs().sum(-1).ne(0).reshape(-1, coefficient.shape[-2])


def _few(where: Bool[Tensor, " n_element"]) -> Int[Tensor, " n_some"] | None:
    """Which these are; None where they are most."""
    found = torch.nonzero(where).flatten()
    return found if 2 * len(found) < len(where) else None
