"""A small basis that serves the whole box of the searched parameters, and the check that it does.

Columns are the modes in the band and somewhat above it, at the middle of the box and at a few other members, without
cutting a cluster of close modes; and the static residual of all higher modes at every response, force, spring, dashpot
and mass, and under what elements with a loss of their own do to the modes in the band (residual flexibility: MacNeal,
Computers & Structures 1 (1971) 581; sampling the box: Balmès, MSSP 10 (1996) 381). The columns are M-orthonormal at the
middle of the box. Whether the basis is good enough is measured against the full model, on members that it was not built
from, and estimated on more of them, at the ends of all intervals too, where springs, masses and dashpots are strongest;
if not, it keeps fainter directions, takes more modes and members in, and is measured again.
"""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.model.discretisation import fine_mesh
from torchplate.model.discretisation.error_estimate import (
    Full,
    basis_error,
    estimated_error,
    full_model,
    relative_error,
)
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.model.plate_model import PlateModel
from torchplate.model.receptance.modal_sum import CLOSE, EXACT
from torchplate.model.receptance.shared_modes import factors, find_shared_modes
from torchplate.plate import Plan

# Directions with less than this part of the largest column are rounding, or say nothing new. What a low mode has of a
# stiff direction counts by its energy: between members far apart it counts below the first limit, down to the second.
INDEPENDENT, FAINT = 1e-11, 1e-13
# Modes up to this multiple of the band's end are kept, round by round, and directions down to so much; higher modes act
# through their static residual.
ROUNDS = ((2.0, INDEPENDENT), (2.0, FAINT), (3.0, FAINT), (4.5, FAINT))
# Modes up to this multiple of the band's end are in it, for what damped elements do to them.
ABOVE = 1.2
# Modes closer than this, relative to their eigenvalue, are kept or left together.
CLUSTER = 1e-2
# Members compared with the full model in each round, and members whose error is estimated once these are right.
N_CHECKED = 4
N_ESTIMATED, N_ESTIMATED_FINE = 8, 4
# Beside these, so many at the ends of all intervals: what is attached at places is strongest, or least, there.
N_END = 16
# With shared modes the worst member of a box is at most about so much worse than the worst of those.
UNSEEN = 2.0
# Terms of the series of far modes, where as few as usual are not enough, and the part of the tolerance left to them.
MORE_TERMS, SPARED = (16, 22, EXACT), 0.1
# Plates that share a basis have natural frequencies that differ by this part at most: what modes beyond the last of a
# basis leave goes with the fourth power of where that is.
SHARED = 0.05
# Two ways to the same numbers agree to this on a box with strong terms; less is not promised.
ROUNDING = 1e-8


@torch.no_grad()
def reduce(
    model: PlateModel,
    frequency: Float[Tensor, " n_frequency"] | None = None,
    n_mode: int = 0,
    tolerance: float = 1e-4,
    also: Float[Tensor, "n_member n_parameter"] | None = None,
    rough: float = 0.0,
) -> tuple[PlateModel, float] | None:
    """The same model in a reduced basis that holds over the whole box, or None where no small basis does.

    Args:
        model: the full model, with its responses and references where FRFs are wanted.
        frequency: lines at which FRFs must be right [Hz]; None if none are wanted.
        n_mode: number of natural frequencies that must be right.
        tolerance: greatest error on members the basis was not built from: of each FRF in relative norm, and of each
            natural frequency relative to itself.
        also: members that the basis is to hold beside its own choice.
        rough: greatest error that was seen of the best basis, which is returned where none is as good as the tolerance;
            with nothing, none is. Of members beyond those that were looked at it says nothing.

    Returns:
        The reduced model and the greatest error found, inside the box and at the ends of its intervals; None where half
        the dofs would be needed, or no basis is as good as the tolerance. Where all members share their modes it holds
        those: see `shared_modes`.
    """
    if (device := model.known.device).type != "cpu":
        # Sparse solves are made on the CPU.
        lines, members = (None if given is None else given.cpu() for given in (frequency, also))
        found_there = reduce(model.on("cpu"), lines, n_mode, tolerance, members, rough)
        return None if found_there is None else (found_there[0].to(device), found_there[1])
    build, probes, more, ends = _members(model)
    everyone = torch.cat([build, *probes, more, ends])
    fine = model.assembly.size > fine_mesh.DENSE
    if fine:
        # Solves of a fine mesh are dear: one member is compared, and fewer are estimated.
        probes, more, ends = [probe[:1] for probe in probes], more[:N_ESTIMATED_FINE], ends[:N_ESTIMATED_FINE]
    estimated, seen = torch.cat([ends, more]), torch.cat([ends, more, *probes[:2]])
    if not model.names:
        # All of these are one.
        estimated, seen = more, more
    reached = frequency
    if (found := factors(model.plan(build[0]), model.plan(everyone))) is not None:
        # All have the modes of the first; the softest and heaviest reads them furthest above the band.
        build = build[:1]
        if frequency is not None:
            reached = frequency * (found[1] / found[0]).max().clamp(min=1.0).sqrt().to(frequency)
    if also is not None:
        build = torch.cat([build, also])
    if frequency is not None and not n_mode and not fine:
        # Shared modes are not solved for again: then all of them cost as little as a few. That every member has them is
        # known from its coefficients, so that one is enough to look at: where terms at places cost most digits.
        whole = _sharing(model, model, everyone)
        if whole is not None:
            whole, errors = _enough_terms(whole, seen, frequency, tolerance)
            error = basis_error(model, whole, seen[errors.argmax(), None], frequency)
            if (error := max(error, UNSEEN * float(errors.max()), ROUNDING)) <= tolerance:
                return whole, error
    rounds = list(zip(ROUNDS, probes, strict=True))
    if not model.names:
        # More modes of the only member take less than another look at it.
        rounds = rounds[2:]
    columns: _Columns | None = None
    full: Full | None = None
    best: tuple[PlateModel, float] | None = None
    for turn, ((margin, independent), probe) in enumerate(rounds):
        if columns is None or columns.margin != margin:
            columns = _ritz_columns(model, build, reached, n_mode, margin)
        basis = columns.independent(independent)
        if basis.shape[-1] > model.assembly.size // 2:
            break
        reduced = model.projected(basis)
        if frequency is not None and (whole := _sharing(model, reduced, everyone)) is not None:
            reduced = _enough_terms(whole, seen, frequency, tolerance)[0]
        if full is None:
            full = full_model(model, probe, frequency, n_mode)
        error, others = full.error(reduced), [full.theta]
        if frequency is not None and error <= max(tolerance, rough):
            errors = estimated_error(model, reduced, estimated, frequency)
            if error <= tolerance:
                others.append(estimated[errors.argmax(), None])
            if (seen_error := max(error, float(errors.max()))) <= (rough if best is None else best[1]):
                best = reduced, seen_error
            error = max(error, _of_all(errors))
        if error <= tolerance:
            return reduced, error
        if turn > 1 and model.names:
            # Before others are taken in, fainter directions of the same members are, and more of their modes: held
            # against the same members, from which these are not built either.
            build, columns, full = torch.cat([build, *others]), None, None
    return best


def _of_all(errors: Float[Tensor, " n_member"]) -> float:
    """The greatest error of many members, from those of some.

    A line that a peak falls on sees an error of the natural frequency that others do not: the more the errors scatter,
    the further beyond the greatest seen is the greatest of a population. For a power law about eight times as many
    members go beyond by (greatest / median) to the power 0.85, for thin tails hardly at all; the root stands between.
    """
    greatest = errors.max()
    return float(greatest * (greatest / errors.median().clamp(min=1e-300)).sqrt())


def _enough_terms(
    whole: PlateModel, theta: Tensor, frequency: Tensor, tolerance: float
) -> tuple[PlateModel, Float[Tensor, " n_member"]]:
    """The model with so many terms of the series of far modes that it is right, and the error of each member.

    What is attached at places is found by a difference: the stronger it is, the more of the digits go.
    """
    shared = whole.shared_modes
    assert shared is not None
    exact = _with_series(whole, EXACT)
    full, errors = exact.frf(theta, frequency), []
    for n_term in (CLOSE, *MORE_TERMS):
        found = _with_series(whole, n_term)
        errors.append(relative_error(found.frf(theta, frequency), full))
        if float(errors[-1].max()) <= SPARED * tolerance:
            break
    single = copy.copy(found)
    single.in_single = True
    off = UNSEEN * float(relative_error(single.frf(theta, frequency), full).max())
    # Where the first terms are most off, digits are too.
    return _with_series(whole, n_term, off), errors[0] * (errors[-1].max() / errors[0].max().clamp(min=1e-300))


def _with_series(whole: PlateModel, n_term: int, single_error: float = 0.0) -> PlateModel:
    assert whole.shared_modes is not None
    twin = copy.copy(whole)
    twin._modules = dict(whole._modules)
    twin.shared_modes = whole.shared_modes.with_series(n_term, single_error)
    return twin


def _members(model: PlateModel) -> tuple[Tensor, list[Tensor], Tensor, Tensor]:
    """Members to build from, the middle of the box first; to be checked, round by round; to be estimated; and ends."""
    parameters = len(model.names)
    middle = model.space.to_si(torch.full((1, parameters), 0.5).to(model.known))
    if not parameters:
        return middle, [middle] * len(ROUNDS), middle, middle
    corners = torch.cat([torch.zeros(1, parameters), torch.ones(1, parameters)]).to(model.known)
    # The engine's first point is the origin: a corner that the basis is built from.
    points = SobolEngine(parameters).draw(1 + N_CHECKED * len(ROUNDS) + N_ESTIMATED, dtype=torch.float64)[1:]
    members = model.space.to_si(points.to(model.known))
    build = torch.cat([middle, model.space.to_si(corners)])
    ends = model.space.to_si(two_level_design(parameters)[:N_END].to(model.known))
    return build, list(members[:-N_ESTIMATED].split(N_CHECKED)), members[-N_ESTIMATED:], ends


def two_level_design(n_parameter: int) -> Float[Tensor, "n_member n_parameter"]:
    """Corners of the unit cube in which any three parameters take all eight pairs of ends, equally often.

    Columns of Sylvester's Hadamard matrix and the same with all signs turned (Plackett and Burman, Biometrika 33 (1946)
    305; Box and Wilson, J. R. Statist. Soc. B 13 (1951) 1). A row and its mirror follow one another.
    """
    sign = torch.ones(1, 1, dtype=torch.float64)
    while len(sign) < n_parameter:
        sign = torch.cat([torch.cat([sign, sign], dim=1), torch.cat([sign, -sign], dim=1)])
    rows = sign[:, :n_parameter]
    return 0.5 * (1 + torch.stack([rows, -rows], dim=1).flatten(0, 1))


def _sharing(model: PlateModel, start: PlateModel, members: Tensor) -> PlateModel | None:
    """The model in the modes that all members share, found in the basis of `start`; None where they share none."""
    found = find_shared_modes(start.assembly, model.plan(members[0]), model.plan(members))
    if found is None:
        return None
    turn, shared = found
    return model.projected(turn if start.assembly.basis is None else start.assembly.basis @ turn, shared)


def sharing_modes(model: PlateModel) -> PlateModel | None:
    """A model in a basis, in the modes that all members of its box share: the same FRFs, without an `eigh` for each.

    Far modes have as many terms of their series as leave rounding alone. For FRFs: it has no matrices.

    Args:
        model: in a basis.

    Returns:
        It; None where members share no modes, or have dampings of their own.
    """
    if model.damping_factor is not None or model.assembly.basis is None:
        return None
    build, _, inside, ends = _members(model)
    # At its ends alone a hole has no area, or no plate is left.
    members = torch.cat([build, ends, inside] if model.has_hole(build[0]) else [build, ends])
    found = find_shared_modes(model.assembly, model.plan(build[0]), model.plan(members))
    if found is None:
        return None
    turn, shared = found
    return model.projected(model.assembly.basis @ turn, shared.with_series(EXACT), matrices=False)


def ritz_basis(
    model: PlateModel,
    theta: Tensor,
    frequency: Tensor | None,
    n_mode: int,
    margin: float,
    independent: float = INDEPENDENT,
    off_marks: bool = False,
    near: Float[Tensor, "n_free k"] | None = None,
) -> Float[Tensor, "n_free n_basis"]:
    """Modes and residuals of all given members, M-orthonormal at the first.

    Args:
        model: in all dofs.
        theta: the members.
        frequency: lines [Hz]; None where a number of modes is wanted.
        n_mode: that number.
        margin: modes kept, in multiples of the band's end or of the number [-].
        independent: part of the strongest column below which one is left out [-].
        off_marks: whether sensors and hits may turn out to be off their marks, by a small part of a wave.
        near: a basis of a similar plate, from which its modes are found sooner.
    """
    return _ritz_columns(model, theta, frequency, n_mode, margin, off_marks, near).independent(independent)


def shares_basis(model: PlateModel, one: Plan, other: Plan, n_mode: int) -> bool:
    """Whether a basis of one plate holds another one too.

    That is so where they differ by factors of the whole plate, which leave its modes as they are, and in how strong
    springs, masses and dashpots at the same places are: what these do is made of the residuals of their places, which
    are in the basis.

    Args:
        model: of which both are members, in all dofs.
        one: of which the basis is made.
        other: the other.
        n_mode: modes in the band. What acts at more places than that has no residual of each place in the basis.
    """
    pairs = list(zip(one.terms, other.terms, strict=False))
    if model.kind == "transmissibility" or len(one.terms) != len(other.terms):
        return False
    if any(a.sprung is not None or b.sprung is not None or a.vector.shape[-2] > n_mode for a, b in pairs):
        return False
    if not all(torch.equal(a.vector, b.vector) for a, b in pairs) or len(one.added) != len(other.added):
        return False
    if not all(torch.equal(a.coupling, b.coupling) for a, b in zip(one.added, other.added, strict=True)):
        return False
    if one.section.loss_factor is not None or any(
        getattr(one.section, name).shape != getattr(other.section, name).shape for name in ("rigidity", "areal_mass")
    ):
        # One differs from place to place.
        return False
    if (found := factors(one, other)) is None:
        return False
    return bool(((found[0] / found[1]).sqrt() - 1).abs() <= SHARED)


class _Columns(NamedTuple):
    """Modes and residuals of some members as they were found, and the combinations of them that are M-orthogonal."""

    margin: float
    stack: Float[Tensor, "n_free n_column"]
    strength: Float[Tensor, " n_column"]
    direction: Float[Tensor, "n_column n_column"]

    def independent(self, least: float) -> Float[Tensor, "n_free n_basis"]:
        """Those that are not less than a part of the strongest, M-orthonormal."""
        kept = self.strength > least * self.strength[-1]
        return self.stack @ self.direction[:, kept] / self.strength[kept].sqrt()


def _ritz_columns(
    model: PlateModel,
    theta: Tensor,
    frequency: Tensor | None,
    n_mode: int,
    margin: float,
    off_marks: bool = False,
    near: Tensor | None = None,
) -> _Columns:
    top = 0.0 if frequency is None else margin * float(frequency.max())
    columns = []
    first: SparseModel | None = None
    for member in theta:
        sparse = SparseModel(model, member)
        first = first or sparse
        wanted = int(margin * n_mode) if n_mode else 1
        # From a basis that is near, modes of a large mesh alone are found sooner.
        large = model.assembly.size > fine_mesh.DENSE
        modes = sparse.modes(wanted, top, sparse.is_sooner_dense(wanted, top), near=near if large else None)
        count = max(int((modes.frequency <= top).sum()), min(len(modes.eigenvalue), int(margin * n_mode)))
        value = modes.eigenvalue
        while count < len(value) and value[count] - value[count - 1] < CLUSTER * value[count]:
            count += 1
        shape = modes.shape[:, :count]
        columns.append(shape)
        if frequency is not None:
            in_band = modes.shape[:, modes.frequency <= ABOVE * top / margin]
            fewer = _fewer_channels(model, member, in_band, off_marks)
            forces = torch.cat([_forces(model, member, in_band, not len(fewer)), _patch_forces(sparse, in_band)])
            residual = sparse.residual(shape, forces)
            if len(fewer):
                once = sparse.residual(shape, fewer)
                residual = torch.cat([residual, once, sparse.residual(shape, sparse.times_mass(once).mT)], dim=-1)
                if off_marks:
                    residual = torch.cat([residual, sparse.residual(shape, _curvatures(model, member))], dim=-1)
            # Scaled to the size of a mode: only directions count.
            columns.append(residual / residual.norm(dim=0).clamp(min=1e-300) * shape.norm(dim=0).mean())
    stack = torch.cat(columns, dim=-1)
    assert first is not None
    gram = stack.mT @ first.times_mass(stack)
    return _Columns(margin, stack, *torch.linalg.eigh(0.5 * (gram + gram.mT)))


def _patch_forces(sparse: SparseModel, modes: Float[Tensor, "n n_mode"]) -> Float[Tensor, "n_row n"]:
    """Rows of what elements with a loss of their own do to some modes: H φ, a quarter of a cycle late."""
    if sparse.hysteretic is None:
        return modes.new_zeros(0, len(modes))
    return torch.from_numpy((sparse.hysteretic @ modes.double().cpu().numpy()).T.copy()).to(modes)


def _forces(
    model: PlateModel, theta: Tensor, modes: Float[Tensor, "n n_mode"], channels: bool
) -> Float[Tensor, "n_row n"]:
    """Rows over the free dofs where something pushes or is read; the inertia of the plate where its base moves.

    What acts along a line at more places than there are modes in the band pushes as these modes make it push.

    Args:
        model: the full one.
        theta: the member.
        modes: those in the band.
        channels: whether those of responses and references are among them.
    """
    plan = model.plan(theta)
    rows = [modes.new_zeros(0, len(modes))]
    for term in plan.terms:
        row, springs = model.assembly.rows(term.vector), term.stiffness
        if len(row) > modes.shape[-1] and springs is not None and bool(springs.any()):
            pushed = [row @ modes]
            if model.assembly.correction is not None:
                # What the correction adds to that pushes, too.
                pushed.append(term.vector[..., model.assembly.free] @ modes)
            row = (springs[:, None] * torch.cat(pushed, dim=-1)).mT @ row
        rows.append(row)
    if channels:
        rows += [_at(model, points, theta) for points in (model.response, model.reference) if points]
    if model.kind == "transmissibility":
        rows.append(model.excitation(plan, None))
    return torch.cat(rows)


def _fewer_channels(
    model: PlateModel, theta: Tensor, modes: Float[Tensor, "n n_mode"], off_marks: bool
) -> Float[Tensor, "n_row n"]:
    """Rows at the side of fewer channels, where the other has more than there are modes in the band; none elsewhere.

    An FRF is of both its ends. With what a force at one moves at rest, K⁻¹f, and K⁻¹ M K⁻¹f in the basis, two terms of
    the series of far modes are right of every FRF that ends there (moment matching; Antoulas, Approximation of
    Large-Scale Dynamical Systems, 2005), as many as K⁻¹f of both ends make right. Where both ends have a vector of
    their own, what one is off its mark counts times what the other is; here the one is to have it where it is, and
    slopes join it.
    """
    fewer, more = sorted((model.response or (), model.reference or ()), key=len)
    if not len(fewer) or len(more) <= max(len(fewer), modes.shape[-1]):
        return theta.new_zeros(0, model.assembly.size)
    orders = ((0, 0), (1, 0), (0, 1)) if off_marks else ((0, 0),)
    return torch.cat([_at(model, fewer, theta, *order) for order in orders])


def _curvatures(model: PlateModel, theta: Tensor) -> Float[Tensor, "n_row n"]:
    """Rows of the second derivatives at the side of fewer channels."""
    fewer = min((model.response or (), model.reference or ()), key=len)
    return torch.cat([_at(model, fewer, theta, *order) for order in ((2, 0), (1, 1), (0, 2))])


def _at(
    model: PlateModel, points: Sequence[int | Sequence[float]], theta: Tensor, order_x: int = 0, order_y: int = 0
) -> Float[Tensor, "n_row n"]:
    return model.assembly.rows(model.mesh.deflection_at(model.mesh.places(points).to(theta), order_x, order_y))
