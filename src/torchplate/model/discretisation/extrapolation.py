"""The model on an infinitely fine mesh, from two finite ones.

The 12-dof rectangle's eigenvalues are off by a h² + O(h⁴). With those of the mesh itself (λ) and of one twice as fine
(λ'), Richardson's (4 λ' − λ) / 3 leaves the O(h⁴) alone (Richardson and Gaunt, Phil. Trans. R. Soc. A 226, 1927).
What the stiffness lacks, in the modes Φ of the mesh, is

    ΔK = M Φ C Φᵀ M,    C = 4/3 (Q Λ' Qᵀ − Λ),

Q the orthogonal matrix nearest to the products of the two meshes' modes, so that close and repeated modes need not be
told from each other. In the same way the modes' deflections at the nodes lack 4/3 (Φ' Qᵀ − Φ), and where elements have
losses of their own, H, these lack 4/3 (Q Φ'ᵀ H' Φ' Qᵀ − Φᵀ H Φ). Other plates of the box lack the stiffness in
proportion to their rigidity, and these losses to them: what then remains is the error of the error.

The finer mesh's modes are found from the coarser one's by two steps of inverse iteration (`SparseModel.modes_near`):
what these miss is a hundredth of the mesh error at most. On the smallest meshes they are solved for: there the coarser
one has few modes beyond those that are wanted, and neither takes long.
"""

import copy
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.model.plate_model import PlateModel
from torchplate.plate import Assembly, Correction, Local, Mesh, prolongation

# Modes up to this multiple of the highest frequency wanted are corrected, unless more is asked for.
MARGIN = 1.6
# Modes closer than this, relative to their eigenvalue, are corrected together or not at all.
CLUSTER = 2e-2
# Least singular value of the products of both meshes' modes at which these are taken for the same.
AGREED = 0.9
# Modes this close, relative to the higher eigenvalue, may be mixed differently on the two meshes.
NEAR = 0.2
# Without a frequency, so many modes.
N_MODE = 30
# Dofs of the finer mesh beyond which its modes are found from those of the coarser one, which has about a quarter of
# them, and so many of the modes.
TWO_GRIDS = 1_000


class Extrapolated(NamedTuple):
    """A model with its mesh error taken off, and how large that was.

    Attributes:
        model: the same, corrected.
        frequency: natural frequencies of the mesh as it is, at the middle of the box [Hz].
        error: how far each of them is off, relative to itself [-]; zero for those on the supports alone.
    """

    model: PlateModel
    frequency: Float[Tensor, " n_mode"]
    error: Float[Tensor, " n_mode"]


@torch.no_grad()
def extrapolate(
    model: PlateModel,
    frequency: float | None = None,
    theta: Float[Tensor, " n_parameter"] | None = None,
    finer: Assembly | None = None,
    margin: float = MARGIN,
) -> Extrapolated:
    """Take the mesh error off a model.

    Args:
        model: the model on its mesh, in all dofs; what was taken off already is put back first.
        frequency: up to where it is to be right [Hz]; left out, its first `N_MODE` modes are corrected.
        theta: the plate whose modes are corrected, in SI units; left out, the middle of the box.
        finer: of the mesh twice as fine; left out, one is made.
        margin: modes up to this multiple of the frequency are corrected [-].
    """
    if model.assembly.correction is not None:
        model = on_mesh(model, model.assembly.corrected(None))
    if theta is None:
        theta = model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known))
    if finer is None:
        finer = Assembly(dataclasses.replace(model.mesh, refine=2 * model.mesh.refine), dense=False)
    twice = on_mesh(model, finer)
    top = 0.0 if frequency is None else margin * frequency
    coarse, fine = SparseModel(model, theta), SparseModel(twice, theta)
    modes = coarse.modes(N_MODE, top, bare=True)
    if len(twice.assembly.free) > TWO_GRIDS:
        start = torch.from_numpy(prolongation(model.mesh, twice.mesh) @ modes.shape.double().cpu().numpy())
        better = fine.modes_near(start.to(modes.shape))
    else:
        better = fine.modes(N_MODE, top, bare=True)
    # Those that were asked for, the same on all meshes. The last that a solver found may have a twin that it did not
    # find, and what lies beyond the top holds what the modes of two grids miss.
    wanted = max(N_MODE, int((modes.frequency <= top).sum()))
    count = min(len(modes.eigenvalue) - 1, len(better.eigenvalue) - 1, wanted)
    across = coarse.times_mass(modes.shape[:, :count]).mT @ better.shape[_common(model.mesh, twice.mesh)][:, :count]

    def apart(value: Tensor) -> bool:
        # A mode beyond the cut whose twin is within it would be half corrected.
        return bool(value[count] - value[count - 1] >= CLUSTER * value[count])

    while count > 1 and not (
        apart(modes.eigenvalue)
        and apart(better.eigenvalue)
        and torch.linalg.svdvals(across[:count, :count])[-1] >= AGREED
    ):
        count -= 1
    shape, value = modes.shape[:, :count], modes.eigenvalue[:count]
    weighted = coarse.times_mass(shape)
    finer_shape = better.shape[_common(model.mesh, twice.mesh)][:, :count]
    across = weighted.mT @ finer_shape
    # Only close modes can be taken for each other: a small part of a high one would outweigh a low one's eigenvalue.
    near = (value - value[:, None]).abs() <= NEAR * torch.maximum(value, value[:, None]).clamp(min=1e-3 * value[-1])
    left, _, right = torch.linalg.svd(across * near)
    turn = left @ right
    change = 4 / 3 * ((turn * better.eigenvalue[:count]) @ turn.mT - torch.diag(value))
    change, more, plan = 0.5 * (change + change.mT), 4 / 3 * (finer_shape @ turn.mT - shape), model.plan(theta)
    correction = Correction(
        weighted.mT.contiguous(),
        change - _by_rows(plan.terms, model.assembly.free, shape, more, value),
        more,
        Correction.measure(plan.section.rigidity, plan.geometry),
        *_lost(coarse, fine, shape, better.shape[:, :count] @ turn.mT),
    )
    twin = on_mesh(model, model.assembly.corrected(correction))
    bending = value > 1e-3 * value[-1]
    error = torch.where(bending, -0.5 * change.diagonal() / value.clamp(min=1.0), 0.0)
    return Extrapolated(twin, modes.frequency[:count], error)


def _by_rows(
    terms: Sequence[Local],
    free: Int[Tensor, " n"],
    shape: Float[Tensor, "n n_mode"],
    more: Float[Tensor, "n n_mode"],
    value: Float[Tensor, " n_mode"],
) -> Float[Tensor, "n_mode n_mode"]:
    """What springs and masses at places add to the modes' eigenvalues by the deflections that these lack there.

    Args:
        terms: that are attached.
        free: dofs.
        shape: modes of the mesh.
        more: what they lack.
        value: eigenvalues.
    """
    stiffness = mass = torch.zeros_like(value).diag()
    for term in terms:
        row = term.vector[..., free].to(shape)
        before, after = row @ shape, row @ (shape + more)
        if term.stiffness is not None:
            stiffness = stiffness + _beside(after, term.stiffness) - _beside(before, term.stiffness)
        if term.mass is not None:
            mass = mass + _beside(after, term.mass) - _beside(before, term.mass)
    # An eigenvalue falls by the mass that is added to its mode times itself.
    omega = value.clamp(min=0.0).sqrt()
    return stiffness - omega[:, None] * mass * omega


def _beside(row: Float[Tensor, "n_row n_mode"], amount: Float[Tensor, " n_row"]) -> Float[Tensor, "n_mode n_mode"]:
    """rowᵀ diag(amount) row: what springs or masses at places are to the modes."""
    return row.mT @ (amount[..., None] * row)


def _lost(
    coarse: SparseModel, fine: SparseModel, shape: Float[Tensor, "n n_mode"], better: Float[Tensor, "n_fine n_mode"]
) -> tuple[Float[Tensor, "n_mode n_mode"], Float[Tensor, ""]] | tuple[None, None]:
    """What the modes of a plate lack of what its elements lose, and how much those lose; None where they lose nothing.

    Args:
        coarse: of the mesh.
        fine: of the finer one.
        shape: modes of the mesh.
        better: the same modes of the finer one.
    """
    lossy = Correction.measure(coarse.plan.section.lossy_rigidity, coarse.plan.geometry)
    if coarse.hysteretic is None or fine.hysteretic is None or float(lossy) <= 0:
        return None, None
    before, after = (
        torch.from_numpy(modes.numpy().T @ (part @ modes.numpy()))
        for part, modes in ((coarse.hysteretic, shape.double().cpu()), (fine.hysteretic, better.double().cpu()))
    )
    change = 4 / 3 * (after - before)
    return (0.5 * (change + change.mT)).to(shape), lossy


def on_mesh(model: PlateModel, assembly: Assembly) -> PlateModel:
    """The same plate with another assembly, on that one's mesh, whatever its effects would make of the mesh."""
    twin = copy.copy(model)
    twin._modules = dict(model._modules)
    twin.mesh, twin.assembly, twin.shared_modes = assembly.mesh, assembly.to(model.known), None
    return twin


def _common(coarse: Mesh, fine: Mesh) -> Tensor:
    """Rows of the finer mesh's free dofs that are those of the coarser one, in its order."""
    n_x, n_y = coarse.cells
    node = (2 * torch.arange(n_y + 1)[:, None] * (2 * n_x + 1) + 2 * torch.arange(n_x + 1)).flatten()
    dof = (3 * node[:, None] + torch.arange(3)).flatten()
    position = torch.full((fine.n_dof,), -1, dtype=torch.int64)
    position[fine.free_dof] = torch.arange(len(fine.free_dof))
    return position[dof[coarse.free_dof]]
