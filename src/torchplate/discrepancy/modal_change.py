"""FRFs by modes, and how they change with what changes a mode, the matrices of a plate, or its supports."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor
from torch.nn.functional import pad

from torchplate.model import (
    Impedance,
    Modes,
    PlateModel,
    modal_denominator,
    modal_impedance,
    own_damping,
    reciprocal,
    solve_modes,
)
from torchplate.plate import Correction, Plan

# Up to this multiple of the band's end a mode that moves is seen to move: higher ones answer as a spring does.
REACH = 1.6
# Numbers of lines, rows, terms and modes that are laid out together: 64 MiB of them.
AT_ONCE = 2**22
# Part of λ from which the slope of a damping is taken.
STEP = 1e-6


class Bare(NamedTuple):
    """Z⁻¹ at every line without what is attached at places, W diag(1/z) W⁻¹; W = I where no losses couple modes.

    Attributes:
        each: 1 / z.
        shape: W, of complex modes in those of the plate without losses; None where each damps itself alone.
        inverse: W⁻¹.
        turned: by how much W⁻¹ Z W is off its diagonal, at a line of another κ, over the change of κ; None where all
            lines share their complex modes.
        kappa: the change of κ at every line [-].
    """

    each: Complex[Tensor, "n_frequency n_mode"]
    shape: Complex[Tensor, "n_mode n_mode"] | None = None
    inverse: Complex[Tensor, "n_mode n_mode"] | None = None
    turned: Complex[Tensor, "n_mode n_mode"] | None = None
    kappa: Complex[Tensor, " n_frequency"] | None = None

    @classmethod
    def of(
        cls,
        z: Complex[Tensor, "n_frequency n_mode"],
        hysteretic: Float[Tensor, "n_mode n_mode"] | None,
        eigenvalue: Float[Tensor, " n_mode"],
        kappa: Complex[Tensor, " n_frequency"],
    ) -> "Bare":
        """Of denominators; where lines do not share their complex modes, about those of the one amid them.

        Args:
            z: of each mode at every line [rad²/s²].
            hysteretic: ΦᵀHΦ, its diagonal in z; None where the elements lose nothing by themselves.
            eigenvalue: λ [rad²/s²].
            kappa: what λ is times in z.
        """
        if hysteretic is None:
            return cls(reciprocal(z))
        amid = len(z) // 2
        between = 1j * (hysteretic - torch.diag_embed(hysteretic.diagonal()))
        value, shape = torch.linalg.eig(torch.diag_embed(z[amid]) + between)
        inverse = torch.linalg.inv(shape)
        each = reciprocal(value + (z - z[amid]) @ (inverse.mT * shape))
        change = kappa - kappa[amid]
        if not change.any():
            return cls(each, shape, inverse)
        turned = inverse @ (eigenvalue[:, None] * shape)
        return cls(each, shape, inverse, turned - torch.diag_embed(turned.diagonal()), change)

    def over(self, left: Tensor, right: Tensor) -> Complex[Tensor, "n_frequency n_left n_right"]:
        """Σ_mn l_m Z⁻¹_mn r_n at every line, for all pairs of rows."""
        if self.shape is None or self.inverse is None:
            return _over(self.each, left, right)
        from_left, from_right = left.to(self.shape) @ self.shape, self.inverse @ right.mT.to(self.shape)
        return self._in_complex_modes(from_left) @ from_right

    def times(self, rows: Tensor) -> Complex[Tensor, "n_frequency n_row n_mode"]:
        """Rows times Z⁻¹; the same at every line, or others."""
        if self.shape is None or self.inverse is None:
            return rows * self.each[:, None]
        return self._in_complex_modes(rows.to(self.shape) @ self.shape) @ self.inverse

    def _in_complex_modes(self, rows: Tensor) -> Complex[Tensor, "n_frequency n_row n_mode"]:
        """Rows times (W⁻¹ZW)⁻¹, to the first order of what is off its diagonal."""
        found = rows * self.each[:, None]
        if self.turned is None or self.kappa is None:
            return found
        return found - (found @ self.turned) * (self.kappa[:, None] * self.each)[:, None]


class Responses(NamedTuple):
    """Rows times Z⁻¹ at every line, as it is made of (Woodbury): rows − carried · attached, times the bare plate's.

    It is not laid out: lines, rows and modes together are more than all that is asked of it.

    Attributes:
        rows: deflections at some places.
        bare: Z⁻¹ without what is attached at places.
        carried: what each of these moves beside them; None where nothing is attached.
        attached: deflections there.
    """

    rows: Float[Tensor, "n_row n_mode"]
    bare: Bare
    carried: Complex[Tensor, "n_frequency n_row n_attached"] | None
    attached: Float[Tensor, "n_attached n_mode"]

    def at(self, modes: Int[Tensor, " n_some"]) -> Complex[Tensor, "n_frequency n_row n_some"]:
        """Of some modes alone."""
        if self.bare.shape is not None:
            rows = self.rows if self.carried is None else self.rows - times_real(self.carried, self.attached)
            return self.bare.times(rows)[..., modes]
        each = self.bare.each[:, None, modes]
        found = self.rows[:, modes] * each
        return found if self.carried is None else found - times_real(self.carried, self.attached[:, modes]) * each

    def to(self, places: Float[Tensor, "n_place n_mode"]) -> Complex[Tensor, "n_frequency n_row n_place"]:
        """Receptances to other places."""
        found = self.bare.over(self.rows, places)
        return found if self.carried is None else found - self.carried @ self.bare.over(self.attached, places)

    def after(
        self, moved: Complex[Tensor, "n_frequency n_moved n_mode"]
    ) -> Complex[Tensor, "n_frequency n_moved n_row"]:
        """Of forces on the modes."""
        moved = self.bare.times(moved)
        found = times_real(moved, self.rows.mT)
        return found if self.carried is None else found - times_real(moved, self.attached.mT) @ self.carried.mT


class Excess(NamedTuple):
    """Damping by which modes are off their law, and how it goes with them.

    Attributes:
        part: of each mode, over what its law makes of it [-].
        damping: at its own frequency [rad²/s²].
        slope: by how much it grows with λ, the mode as it is [-].
        coupled: by how much that of a mode, in a row, grows as it takes in another one [rad²/s²].
    """

    part: Float[Tensor, " n_mode"]
    damping: Float[Tensor, " n_mode"]
    slope: Float[Tensor, " n_mode"]
    coupled: Float[Tensor, "n_mode n_mode"]

    @classmethod
    def of(cls, z: Impedance, own: Tensor, factor: Tensor, force: Callable[[Tensor], Tensor]) -> "Excess":
        """Of the lowest modes, so many times what their law makes of them, less that.

        Args:
            z: the impedance, without it.
            own: what damps each mode by its law.
            factor: of the lowest modes.
            force: dynamic stiffness of what is attached, at any s.
        """
        value, n = z.eigenvalue, min(len(factor), len(own))
        off = pad(factor[:n] - 1, (0, len(own) - n))
        higher = own_damping(z._replace(stiffness=z.stiffness * (1 + STEP)), force)
        pulled = force(1j * value.clamp(min=0.0).sqrt()).imag * z.dashpot
        coupled = pulled.mT @ z.dashpot if z.hysteretic is None else pulled.mT @ z.dashpot + z.hysteretic
        slope = off * (higher - own) / (STEP * value.abs().clamp(min=1.0))
        return cls(off, off * own, slope, 2 * off[:, None] * coupled)

    def turned(
        self,
        eigenvalue: Float[Tensor, " n_mode"],
        stiffness: Float[Tensor, "n_term n_mode n_mode"],
        mass: Float[Tensor, "n_term n_mode n_mode"],
    ) -> Float[Tensor, "n_term n_mode n_mode"]:
        """What changes of stiffness and mass do to it, in coordinates of the modes, with which it turns.

        It is E = Σ_r e_r (M φ_r)(M φ_r)ᵀ. To the first order E_rs changes by
        [e_r (K_rs − λ_s M_rs) − e_s (K_rs − λ_r M_rs)] / (λ_r − λ_s), K and M the changes; and e_r with λ_r and with
        what is attached where φ_r takes in (K_rs − λ_r M_rs) / (λ_r − λ_s) of φ_s. Modes nearer to one another than
        they are coupled by turn by an eighth of a turn at most.
        """
        column, each = eigenvalue[:, None], self.damping
        within = (column - eigenvalue).square() + 4 * stiffness.square()
        over = (column - eigenvalue) / within.clamp(min=torch.finfo(eigenvalue.dtype).tiny)
        off = stiffness - column * mass
        between = (each[:, None] * (stiffness - eigenvalue * mass) - each * off) * over
        heavier = mass.diagonal(dim1=-2, dim2=-1)
        taken_in = (self.coupled * off * over).sum(-1) - 0.5 * self.coupled.diagonal() * heavier
        alone = each * heavier + self.slope * off.diagonal(dim1=-2, dim2=-1) + taken_in
        return between + torch.diag_embed(alone)


class Modal(NamedTuple):
    """A model's reading taken apart into modes.

    Attributes:
        eigenvalue: λ [rad²/s²].
        shape: Φ, over the rows of the model's matrices.
        kappa: what λ is times in the denominator.
        lossy: part of a change of the elements' stiffness that adds to what they lose by themselves [-].
        damping: the part of the denominator that damps [rad²/s²].
        denominator: z.
        inverse: 1 / z.
        bare: z without what is attached at places.
        attached: Φ there.
        force: dynamic stiffness there [N/m].
        own_damping: what damps each mode at its own frequency [rad²/s²].
        excess: that part of it by which it is off its law; None where none is.
        left: Φ at the responses.
        right: at the references.
        from_left: Φ at the responses times Z⁻¹ at every line, what is attached at places and all.
        from_right: likewise at the references.
        n_low: modes in the band and a little above it.
    """

    eigenvalue: Float[Tensor, " n_mode"]
    shape: Float[Tensor, "n n_mode"]
    kappa: Complex[Tensor, "n_frequency n_mode"]
    lossy: Float[Tensor, ""]
    damping: Complex[Tensor, "n_frequency n_mode"]
    denominator: Complex[Tensor, "n_frequency n_mode"]
    inverse: Complex[Tensor, "n_frequency n_mode"]
    bare: Complex[Tensor, "n_frequency n_mode"]
    attached: Float[Tensor, "n_attached n_mode"]
    force: Complex[Tensor, "n_attached n_frequency"]
    own_damping: Float[Tensor, " n_mode"]
    excess: "Excess | None"
    left: Float[Tensor, "n_response n_mode"]
    right: Float[Tensor, "n_reference n_mode"]
    from_left: Responses
    from_right: Responses
    n_low: int


def by_modes(model: PlateModel, plan: Plan, laplace: Tensor, response: Tensor, reference: Tensor | None) -> Modal:
    """A model's reading at some lines taken apart."""
    system = model.assembly.system(*plan)
    eigenvalue, shape = solve_modes(system.stiffness, system.mass)
    real, imaginary = modal_denominator(eigenvalue, system.proportional, laplace)
    bare = torch.complex(real, imaginary)
    impedance = modal_impedance(system, Modes(eigenvalue, shape), laplace)
    if impedance.hysteretic is not None:
        bare = bare + 1j * impedance.hysteretic.diagonal()
    own, excess = own_damping(impedance, system.force), None
    if model.damping_factor is not None:
        excess = Excess.of(impedance, own, model.damping_factor, system.force)
        bare, own = bare + 1j * excess.damping, own + excess.damping
    attached, force = system.attached @ shape, system.force(laplace)
    denominator = bare + force.mT @ attached.square().to(force)
    plain = eigenvalue + laplace[:, None].square()
    kappa, _ = system.proportional.at(laplace)
    of_bare = Bare.of(bare, impedance.hysteretic, eigenvalue, kappa.expand(len(bare)))
    left = model.assembly.rows(model.mesh.deflection_at(response)) @ shape
    right = model.excitation(plan, reference) @ shape
    n_low = int((eigenvalue < (REACH * float(laplace.imag.max())) ** 2).sum())
    kappa = kappa[:, None].expand_as(denominator)
    section, geometry = plan.section, plan.geometry
    lossy = eigenvalue.new_zeros(())
    if section.loss_factor is not None:
        # As an assembly has it of an uneven plate.
        whole = Correction.measure(section.rigidity, geometry)
        lossy = Correction.measure(section.lossy_rigidity, geometry) / whole
    damping = denominator - plain
    inverse = reciprocal(denominator)
    from_left, from_right = (_responses(of_bare, attached, force, rows) for rows in (left, right))
    return Modal(
        eigenvalue,
        shape,
        kappa,
        lossy,
        damping,
        denominator,
        inverse,
        bare,
        attached,
        force,
        own,
        excess,
        left,
        right,
        from_left,
        from_right,
        n_low,
    )


def _responses(
    bare: Bare,
    attached: Float[Tensor, "n_attached n_mode"],
    force: Complex[Tensor, "n_attached n_frequency"],
    rows: Float[Tensor, "n_row n_mode"],
) -> Responses:
    """Rows times Z⁻¹ at every line; what is attached at places couples the modes."""
    if not len(attached):
        return Responses(rows, bare, None, attached)
    force = force.mT
    between, pulled = (bare.over(one, attached) for one in (attached, rows))
    coupled = torch.eye(len(attached)).to(between) + force[..., None] * between
    # Few rows: each is carried to the attached places, and not all modes there.
    carried = torch.linalg.solve(coupled, pulled, left=False) * force[:, None]
    return Responses(rows, bare, carried, attached)


def _over(each: Tensor, left: Tensor, right: Tensor) -> Complex[Tensor, "n_frequency n_left n_right"]:
    """Σ_m l_m r_m e_m at every line, for all pairs of rows."""
    pairs = (left[:, None] * right[None]).flatten(0, 1)
    return times_real(each, pairs.mT).unflatten(-1, (len(left), len(right)))


def from_responses(modal: Modal, rows: Float[Tensor, "n_row n_mode"]) -> Tensor:
    """Receptances from the responses to other places, at every line."""
    return modal.from_left.to(rows)


def to_references(modal: Modal, rows: Float[Tensor, "n_row n_mode"]) -> Tensor:
    """Receptances from other places to the references, at every line."""
    return modal.from_right.to(rows).mT


def as_modes_move(modal: Modal, change: Complex[Tensor, "n_frequency n_mode"]) -> Tensor:
    """What a change of all modes' denominators does to the receptances, all at once."""
    fewer, more, swapped = _by_size(modal.from_left, modal.from_right)
    found = -more.after(fewer.at(torch.arange(len(modal.eigenvalue))) * change[:, None])
    return found.mT if swapped else found


def sum_of_modes(modal: Modal, left: Tensor, right: Tensor) -> Tensor:
    """Σ_m l_m r_m / z_m at every line, for all pairs of rows, the damping that couples modes left out."""
    return _over(modal.inverse, left, right)


def of_modes(
    modal: Modal, modes: Int[Tensor, " n_some"], change: Complex[Tensor, "n_frequency n_some"]
) -> Complex[Tensor, "n_some n_frequency n_response n_reference"]:
    """What a change of some modes' denominators does to the receptances, each alone."""
    left = (-change[:, None] * modal.from_left.at(modes)).movedim(-1, 0)
    return left[..., None] * modal.from_right.at(modes).movedim(-1, 0)[:, :, None]


def through_each(
    modal: Modal,
    stiffness: Float[Tensor, "n_term n_mode n_mode"],
    mass: Float[Tensor, "n_term n_mode n_mode"],
    s: Tensor,
    lossy: bool = False,
) -> Complex[Tensor, "n_term n_frequency n_response n_reference"]:
    """What several changes of stiffness and mass, in coordinates of all modes, do to the receptances, each alone.

    Args:
        modal: the model.
        stiffness: of each change [rad²/s²].
        mass: likewise [-].
        s: the lines [1/s].
        lossy: the stiffness is one of loss, i times it, whatever the loss factor of the whole.
    """
    if not len(stiffness):
        return modal.bare.new_zeros(0, len(s), len(modal.left), len(modal.right))
    from_fewer, more, swapped = _by_size(modal.from_left, modal.from_right)
    fewer, n_more = from_fewer.at(torch.arange(len(modal.eigenvalue))), len(more.rows)
    imaginary, excess = 1j * torch.ones_like(s), modal.excess
    lost = 1.0 if lossy else modal.lossy
    pairs = [(stiffness, imaginary if lossy else modal.kappa[:, 0] + 1j * modal.lossy), (mass, s.square())]
    if excess is not None:
        own = torch.diag_embed(excess.part * lost * stiffness.diagonal(dim1=-2, dim2=-1))
        turned = own if lossy else own + excess.turned(modal.eigenvalue, stiffness, mass)
        pairs.append((turned, imaginary))
    change = fewer.new_zeros(len(stiffness), len(s), fewer.shape[1], n_more)
    # One real product for all lines and as many terms as may be laid out together.
    n_term = max(1, AT_ONCE // fewer.numel())
    for matrices, factor in pairs:
        some, which, multiple = _multiples(matrices)
        for first in range(0, len(some), n_term):
            felt = _felt(fewer, more, matrices[some[first : first + n_term]]).mul_(factor[:, None, None])
            for index, one in enumerate(which.tolist()):
                if first <= one < first + len(felt):
                    change[index].sub_(felt[one - first], alpha=float(multiple[index]))
    return change.mT if swapped else change


def _felt(fewer: Tensor, more: Responses, matrices: Tensor) -> Complex[Tensor, "n_term n_frequency n_row n_more"]:
    """What some matrices bring from rows times Z⁻¹ to others."""
    beside = matrices.movedim(0, 1).flatten(1)
    felt = times_real(fewer.flatten(0, 1), beside).unflatten(-1, (-1, fewer.shape[-1]))
    felt = more.after(felt.unflatten(0, fewer.shape[:2]).flatten(1, 2))
    return felt.unflatten(1, (fewer.shape[1], -1)).movedim(2, 0)


def _by_size(left: Responses, right: Responses) -> tuple[Responses, Responses, bool]:
    """The one of fewer rows, the other, and whether that is the wrong way round."""
    return (left, right, False) if len(left.rows) <= len(right.rows) else (right, left, True)


def _multiples(
    matrices: Float[Tensor, "n_term n_mode n_mode"],
) -> tuple[Int[Tensor, " n_own"], Int[Tensor, " n_term"], Float[Tensor, " n_term"]]:
    """The matrices that are no multiple of one before; of each which of these it is a multiple of, and what multiple.

    Thickness and modulus that wander alike change the stiffness alike.
    """
    norm = matrices.flatten(1).norm(dim=1)
    unit = matrices.flatten(1) / norm.clamp(min=1e-300)[:, None]
    alike = unit @ unit.mT
    # Equal to the root of rounding: as good as columns of a covariance have to be.
    first = (alike.abs() > 1 - 1e-12).to(torch.int64).argmax(dim=1)
    every = torch.arange(len(norm))
    own = (first == every) & (norm > 0)
    which = (own.cumsum(0) - 1).clamp(min=0)[first]
    multiple = torch.where(norm > 0, alike[every, first] * norm / norm[first].clamp(min=1e-300), 0.0)
    return torch.nonzero(own).flatten(), which, multiple


def times_real(complex_rows: Tensor, real: Tensor) -> Tensor:
    """Complex rows times a real matrix."""
    return torch.complex(complex_rows.real @ real, complex_rows.imag @ real)
