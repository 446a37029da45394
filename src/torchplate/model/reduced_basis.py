"""A small basis that serves the whole box of the searched parameters, and the check that it does.

Columns are the modes in the band and somewhat above it, at the middle of the box and at a few other members, without
cutting a cluster of close modes; and the static residual of all higher modes at every response, force, spring, dashpot
and mass (residual flexibility: MacNeal, Computers & Structures 1 (1971) 581; sampling the box: Balmès, MSSP 10 (1996)
381). The columns are M-orthonormal at the middle of the box. Whether the basis is good enough is measured against the
full model, on members that it was not built from; if not, it takes those in, with more modes, and is measured again.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.model.fine_mesh import SparseModel
from torchplate.model.plate_model import PlateModel

# Modes up to this multiple of the band's end are kept, round by round; higher ones act through their static residual.
MARGIN = (2.0, 3.0, 4.5)
# Modes closer than this, relative to their eigenvalue, are kept or left together.
CLUSTER = 1e-2
# Directions with less than this part of the largest column are rounding, or say nothing new.
INDEPENDENT = 1e-11
N_CHECKED = 4
# Beyond so many dofs the full model is never solved densely: modes by sparse shift-invert, checks by sparse solves.
DENSE = 1000
# Lines at which a fine mesh is checked.
N_LINE_CHECKED = 8


@torch.no_grad()
def reduce(
    model: PlateModel,
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
    tolerance: float = 1e-4,
) -> tuple[PlateModel, float] | None:
    """The same model in a reduced basis that holds over the whole box, or None where no small basis does.

    Args:
        model: the full model, with its responses and references where FRFs are wanted.
        frequency: lines at which FRFs must be right [Hz]; None if none are wanted.
        n_mode: number of natural frequencies that must be right.
        tolerance: greatest error on members the basis was not built from: of each FRF in relative norm, and of each
            natural frequency relative to itself.

    Returns:
        The reduced model and the greatest error found; None where half the dofs would be needed.
    """
    parameters = len(model.names)
    middle = model.space.to_si(torch.full((1, parameters), 0.5).to(model.known))
    build = middle
    probes: Sequence[Tensor] = [middle] * len(MARGIN)
    if parameters:
        corners = torch.cat([torch.zeros(1, parameters), torch.ones(1, parameters)]).to(model.known)
        build = torch.cat([middle, model.space.to_si(corners)])
        # The engine's first point is the origin: a corner that the basis is built from.
        points = SobolEngine(parameters).draw(1 + N_CHECKED * len(MARGIN), dtype=torch.float64)[1:]
        probes = model.space.to_si(points.to(model.known)).split(N_CHECKED)
    for margin, probe in zip(MARGIN, probes, strict=True):
        basis = _basis(model, build, frequency, n_mode, margin)
        if basis.shape[-1] > model.assembly.size // 2:
            return None
        reduced = model.projected(basis)
        error = basis_error(model, reduced, probe, frequency, n_mode)
        if error <= tolerance:
            return reduced, error
        if parameters:
            build = torch.cat([build, probe])
    return None


@torch.no_grad()
def basis_error(
    model: PlateModel,
    reduced: PlateModel,
    theta: Float[Tensor, "n_member n_parameter"],
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
) -> float:
    """Greatest error of the reduced model: of FRFs in relative norm, of natural frequencies relative to themselves.

    On a mesh of more than `DENSE` dofs the FRFs are compared at `N_LINE_CHECKED` lines over the band.
    """
    errors = [0.0]
    fine = model.assembly.size > DENSE
    if frequency is not None:
        if fine:
            index = torch.linspace(0, len(frequency) - 1, min(N_LINE_CHECKED, len(frequency))).round().long()
            frequency = frequency[index.to(frequency.device)]
            full = torch.stack([SparseModel(model, member).frf(frequency) for member in theta])
        else:
            full = model.frf(theta, frequency)
        small = reduced.frf(theta, frequency)
        errors.append(float(((small - full).norm(dim=-3) / full.norm(dim=-3)).max()))
    if n_mode:
        if fine:
            full = torch.stack([SparseModel(model, member).modes(n_mode).frequency[:n_mode] for member in theta])
        else:
            full = model.natural_frequencies(theta, n_mode)
        small = reduced.natural_frequencies(theta, n_mode)
        # Rigid-body modes of a free plate are zero up to rounding; they are held to the first frequency that is not.
        floor = full[full > 1e-3 * full.max()].min()
        errors.append(float(((small - full).abs() / full.clamp(min=float(floor))).max()))
    return max(errors)


def _basis(
    model: PlateModel, theta: Tensor, frequency: Tensor | None, n_mode: int, margin: float
) -> Float[Tensor, "n_free n_basis"]:
    """Modes and residuals of all given members, M-orthonormal at the first."""
    top = 0.0 if frequency is None else margin * float(frequency.max())
    columns = []
    first: SparseModel | None = None
    for member in theta:
        sparse = SparseModel(model, member)
        first = first or sparse
        modes = sparse.modes(int(margin * n_mode) if n_mode else 1, top, dense=model.assembly.size <= DENSE)
        count = max(int((modes.frequency <= top).sum()), min(len(modes.eigenvalue), int(margin * n_mode)))
        value = modes.eigenvalue
        while count < len(value) and value[count] - value[count - 1] < CLUSTER * value[count]:
            count += 1
        shape = modes.shape[:, :count]
        columns.append(shape)
        if frequency is not None:
            residual = sparse.residual(shape, _forces(model, member))
            # Scaled to the size of a mode: only directions count.
            columns.append(residual / residual.norm(dim=0).clamp(min=1e-300) * shape.norm(dim=0).mean())
    stack = torch.cat(columns, dim=-1)
    assert first is not None
    gram = stack.mT @ first.times_mass(stack)
    strength, direction = torch.linalg.eigh(0.5 * (gram + gram.mT))
    kept = strength > INDEPENDENT * strength[-1]
    return stack @ direction[:, kept] / strength[kept].sqrt()


def _forces(model: PlateModel, theta: Tensor) -> Float[Tensor, "n_row n"]:
    """Rows over the free dofs where something pushes or is read; the inertia of the plate where its base moves."""
    plan = model.plan(theta)
    rows = [model.assembly.rows(term.vector) for term in plan.terms]
    for points in (model.response, model.reference):
        if points:
            rows.append(model.assembly.rows(model.mesh.deflection_at(model.mesh.places(points).to(theta))))
    if model.kind == "transmissibility":
        rows.append(model.excitation(plan, None))
    return torch.cat(rows)
