"""Plates that share their modes: receptances of a whole population without solving one eigenproblem.

Where Young's modulus, thickness or density change, every element changes alike: K_plate = e K₀ and M_plate = m M₀. The
eigenvectors of such plates are those of the nominal one. With damping in proportion to K and M,

    Z(s) = eκ (K₀ − z M₀) + Uᵀ D U,    z = −mμ / eκ,    κ = 1 + iβ + sb, μ = iη + sa + s²,

so all plates at all lines read one and the same function G(z) = Σ φφᵀ / (λ − z) of one complex number, and no `eigh` is
needed: see `modal_sum`. Springs, dashpots and masses at places (D, a few rows U) are attached to it; the nominal ones
are already in K₀, and the least masses in M₀. What is attached is found by a difference, (D⁻¹ + G)⁻¹: where it is
strong, the error of the series of far modes and the rounding of single precision grow by as much as digits go there.
`reduced_basis` measures both, and takes as many terms as are needed.

Everything here is a smooth formula of theta in plain torch operations: its derivatives of any order are torch's own.
"""

import copy
import functools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from torchplate.model.receptance.attach import lines_last, terms_first
from torchplate.model.receptance.attached_sum import Rows, attached_sum
from torchplate.model.receptance.batched import stack_rows
from torchplate.model.receptance.modal_sum import CLOSE, LINES_AT_ONCE, Disc, Stretch, reciprocal
from torchplate.model.receptance.modes import solve_modes
from torchplate.plate import (
    REMEMBERED,
    Assembly,
    Plan,
    Proportional,
    Sprung,
    common_shape,
    concatenate,
    is_vmapped,
    mass_coefficient,
    stiffness_coefficient,
    transformed,
    uneven_coefficient,
    uneven_mass_coefficient,
)

# Attaching terms one after the other costs the square of their number; with more, one `eigh` each is cheaper.
MOST_TERMS = 12
# Coefficients of members agree to rounding, or they are not multiples of the nominal ones.
ALIKE = 1e-12


class Nominal(NamedTuple):
    """What the modes belong to: coefficients of the plate that all others are multiples of, and what is attached."""

    stiffness: Float[Tensor, "n_element 6"]
    mass: Float[Tensor, "n_element 1"]
    spring: Float[Tensor, " n_term"]  # already in K₀ [N/m]
    lump: Float[Tensor, " n_term"]  # already in M₀ [kg]


class Attached(NamedTuple):
    """Springs, masses and dashpots at places, beyond what K₀ and M₀ hold of them; None where there is nothing."""

    row: Float[Tensor, "*#batch n_term n"]  # modal deflections [1/√kg]
    lump: Float[Tensor, "*#batch n_term"] | None  # over m [kg]
    spring: Float[Tensor, "*#batch n_term"] | None  # over e [N/m]
    viscous: Float[Tensor, "*#batch n_term"] | None  # [N s/m]
    sprung: Sequence[tuple[int, Sprung]] = ()  # masses on springs, and the first term of each

    def stiffness(
        self,
        z: Complex[Tensor, "*batch n_frequency"],
        laplace: Complex[Tensor, "*#batch n_frequency"],
        flexibility: Complex[Tensor, "*#batch #n_frequency"],
    ) -> Complex[Tensor, "n_term *batch n_frequency"]:
        """D / eκ = k/e − z m/m + c s/eκ, and of a mass on a spring its own D / eκ; 1/eκ is the flexibility."""
        rate = (laplace * flexibility).expand(z.shape).to(z)
        parts = []
        for value, weight in zip(self[1:4], (-z, None, rate), strict=True):
            if value is not None:
                own = terms_first(value, z.ndim - 1).to(z.real.dtype)
                parts.append(own if weight is None else own * weight)
        total = functools.reduce(torch.add, parts, z.new_zeros(self.row.shape[-2], *(1,) * z.ndim))
        for first, sprung in self.sprung:
            own = (lines_last(sprung.force(laplace), z.ndim - 1) * flexibility).to(z)
            total = total + torch.nn.functional.pad(
                own.expand(len(own), *z.shape), (0, 0) * z.ndim + (first, len(total) - first - len(own))
            )
        return total.expand(len(total), *z.shape)


class SharedModes(nn.Module):
    """Receptances of every plate that is the nominal one times a stiffness and a mass factor, with terms attached.

    Args:
        eigenvalue: λ of (K₀, M₀) in the assembly's basis, whose vectors are the modes, lowest first [rad²/s²].
        nominal: what K₀ and M₀ were assembled from.
        ends: least and greatest m/e and the same of the kinds of damping in the box, which tell where z may be.
    """

    eigenvalue: Tensor
    stiffness: Tensor
    mass: Tensor
    spring: Tensor
    lump: Tensor
    ends: Tensor

    def __init__(self, eigenvalue: Float[Tensor, " n"], nominal: Nominal, ends: Float[Tensor, "6 2"]) -> None:
        super().__init__()
        self._stretches: dict[tuple[object, ...] | None, list[Stretch]] = {}
        self.n_term, self.single_error = CLOSE, 0.0
        # One entry tells the factor of all: the largest is never one that vanishes.
        self.entry = divmod(int(nominal.stiffness.abs().argmax()), nominal.stiffness.shape[-1])
        parts = {
            "eigenvalue": eigenvalue,
            "stiffness": nominal.stiffness[self.entry],
            "mass": nominal.mass.flatten()[0],
            "spring": nominal.spring,
            "lump": nominal.lump,
            "ends": ends,
        }
        for name, value in parts.items():
            self.register_buffer(name, value, persistent=False)

    def with_series(self, n_term: int, single_error: float = 0.0) -> "SharedModes":
        """The same, with far modes as another series.

        Args:
            n_term: terms of the series.
            single_error: how far single precision was found to be off, of an FRF in relative norm.
        """
        twin = copy.copy(self)
        twin._buffers = dict(self._buffers)
        twin._stretches, twin.n_term, twin.single_error = {}, n_term, single_error
        return twin

    def receptance(
        self,
        assembly: Assembly,
        plan: Plan,
        laplace: Complex[Tensor, "*#batch n_frequency"],
        left: Float[Tensor, "*#batch n_left n"],
        right: Float[Tensor, "*#batch n_right n"],
        in_single: bool = False,
    ) -> Complex[Tensor, "*batch n_frequency n_left n_right"]:
        """α [m/N].

        Args:
            assembly: in the basis of the modes.
            plan: what the effects make of the members.
            laplace: s [1/s].
            left: modal deflections at the responses [1/√kg].
            right: modal deflections at the references [1/√kg].
            in_single: products and sums in single precision, for values alone, and where no place is searched.
        """
        stiffness, mass = _coefficients(plan)
        e, m = stiffness[..., self.entry[0], self.entry[1]] / self.stiffness, mass[..., 0, 0] / self.mass
        damping = assembly.proportional(plan.damping)
        attached = self._attached(assembly, plan, e, m)
        sides = [stack_rows(attached.row, side) for side in (left, right)]
        kappa, mu = damping.at(laplace)
        parts = (*attached[1:4], *(part for _, own in attached.sprung for part in own), kappa, mu)
        values = [part.shape[:-1] for part in parts if part is not None]
        batch = common_shape(e.shape, m.shape, *values, *(side.shape[:-2] for side in sides))
        flexibility = reciprocal(e[..., None] * kappa)
        # Of the whole batch, also where only terms or places differ between the members.
        z = (-m[..., None] * mu * flexibility).expand(*batch, laplace.shape[-1])
        rows = Rows(self.eigenvalue, *sides)
        in_single = in_single and rows.alike
        numbers = torch.complex64 if in_single else z.dtype
        force = attached.stiffness(z.to(numbers), laplace, flexibility)
        # What stays in the cache.
        at_once = LINES_AT_ONCE * (1 + in_single) if laplace.device.type == "cpu" else laplace.shape[-1]
        stretches: Sequence[Stretch] = self._expected(laplace, at_once, m / e, damping) or [
            self._around(block) for block in z.split(at_once, dim=-1)
        ]
        found = attached_sum(rows, z, force, stretches, at_once, flexibility, in_single)
        return found.movedim((0, 1), (-2, -1))

    def _expected(self, laplace: Tensor, at_once: int, ratio: Tensor, damping: Proportional) -> list[Stretch] | None:
        """Where z of each block of lines may be in the box; None of members beyond it, or a bent s: nobody knows."""
        if laplace.ndim > 1 or torch.is_inference_mode_enabled():
            return None
        if is_vmapped(ratio, *damping):
            return None
        for part, (low, high) in zip((ratio, *damping), self.ends.tolist(), strict=True):
            least, greatest = part.detach().aminmax() if isinstance(part, Tensor) else (part, part)
            if float(least) < low - ALIKE * abs(low) or float(greatest) > high + ALIKE * abs(high):
                return None
        key = None if transformed() else (laplace.device, laplace.dtype, at_once, laplace.cpu().numpy().tobytes())
        found = self._stretches.get(key)
        if found is None:
            corner = torch.cartesian_prod(*self.ends).unique(dim=0).mT
            damping = Proportional(*corner[1:])
            kappa, mu = (damping if corner[-1].any() else damping._replace(loss_exponent=0.0)).at(laplace)
            z = -corner[0, :, None] * mu / kappa
            found = [self._around(block) for block in z.split(at_once, dim=-1)]
            if key is not None:
                if len(self._stretches) >= REMEMBERED:
                    self._stretches.clear()
                self._stretches[key] = found
        return found

    def _around(self, z: Tensor) -> Stretch:
        return Stretch.around(Disc.around(z, self.eigenvalue), self.eigenvalue, self.n_term)

    def _attached(self, assembly: Assembly, plan: Plan, e: Tensor, m: Tensor) -> Attached:
        """All terms; a mass over m and a spring over e, so that what M₀ and K₀ hold of them is the same for all."""
        rows = [self.eigenvalue.new_zeros(0, len(self.eigenvalue))]
        values: list[list[Tensor]] = [[], [], []]
        hung: list[tuple[int, Sprung]] = []
        first = 0
        for term in plan.terms:
            here = slice(first, first := first + term.vector.shape[-2])
            rows.append(assembly.rows(term.vector))
            if term.sprung is not None:
                hung.append((here.start, term.sprung))
            held = self.lump[here], self.spring[here], torch.zeros_like(self.spring[here])
            for total, value, over, part in zip(values, term[1:4], (m, e, torch.ones_like(e)), held, strict=True):
                total.append(-part if value is None else value / over[..., None] - part)
        used = [any(term[kind] is not None for term in plan.terms) for kind in (1, 2, 3)]
        together = [concatenate(total, 1) if some else None for total, some in zip(values, used, strict=True)]
        return Attached(concatenate(rows, 2), together[0], together[1], together[2], hung)


def _coefficients(plan: Plan) -> tuple[Tensor, Tensor]:
    return (
        stiffness_coefficient(plan.section.rigidity, plan.geometry),
        mass_coefficient(plan.section.areal_mass, plan.geometry),
    )


def _least(value: Float[Tensor, "*batch n_term"]) -> Float[Tensor, " n_term"]:
    """Of each term, over all members."""
    return value.reshape(-1, value.shape[-1]).amin(0)


def factors(nominal: Plan, members: Plan) -> tuple[Tensor, Tensor] | None:
    """Stiffness and mass factor of all members; None where they are no multiples of the nominal plate.

    Members to which too much is attached count as none: an `eigh` for each is then cheaper.

    Args:
        nominal: one member.
        members: a batch of them, wide enough to show what moves.
    """
    if members.section.loss_factor is not None or sum(term.vector.shape[-2] for term in members.terms) > MOST_TERMS:
        return None
    return multiples(nominal, members)


def multiples(nominal: Plan, members: Plan) -> tuple[Tensor, Tensor] | None:
    """The same, whatever is attached and lost: then the bare plates have one set of modes.

    Args:
        nominal: one member.
        members: a batch of them.
    """
    found = []
    for one, many in zip(_coefficients(nominal), _coefficients(members), strict=True):
        largest = one.abs().flatten().argmax()
        factor = many.flatten(-2)[..., largest, None] / one.flatten()[largest]
        error = (many.flatten(-2) - factor * one.flatten()).abs()
        if bool((error > ALIKE * (factor * one.flatten()[largest]).abs()).any()):
            return None
        found.append(factor[..., 0])
    for own, others in zip(nominal.added, members.added, strict=True):
        # What is spread over the plate is in M₀, and must be the same part of each member's mass.
        apart = others.coefficient - found[1] * own.coefficient
        if bool((apart.abs() > ALIKE * own.coefficient.abs()).any()):
            return None
    return found[0], found[1]


def find_shared_modes(assembly: Assembly, nominal: Plan, members: Plan) -> tuple[Tensor, SharedModes] | None:
    """The modes that all members share, as combinations of the assembly's vectors [n, n]; None where they share none.

    Args:
        assembly: in all dofs or in a basis.
        nominal: one member.
        members: a batch of them, wide enough to show what moves.
    """
    found = factors(nominal, members)
    if found is None:
        return None
    section, geometry = nominal.section, nominal.geometry
    uneven = uneven_coefficient(section, section.uneven, geometry)
    stiffness = assembly.stiffness(section.rigidity, geometry, uneven)
    mass = assembly.mass(section.areal_mass, geometry, uneven_mass_coefficient(section, geometry))
    for added in nominal.added:
        mass = mass + added.coefficient * assembly.added_mass(added)
    spring, lump = [], []
    for one, many in zip(nominal.terms, members.terms, strict=True):
        # A term whose place is searched belongs to no common K₀ and M₀.
        fixed = many.vector.ndim == one.vector.ndim
        nothing = stiffness.new_zeros(one.vector.shape[-2])
        spring.append(one.stiffness if fixed and one.stiffness is not None else nothing)
        # The least of all members: a mass that M₀ holds and a member has not is taken off again, digits with it.
        lump.append(_least(many.mass) if fixed and many.mass is not None else nothing)
        row = assembly.rows(one.vector)
        stiffness, mass = stiffness + row.mT @ (spring[-1][:, None] * row), mass + row.mT @ (lump[-1][:, None] * row)
    modes = solve_modes(stiffness, mass)
    nothing = stiffness.new_zeros(0)
    whole = Nominal(*_coefficients(nominal), torch.cat([nothing, *spring]), torch.cat([nothing, *lump]))
    parts = torch.broadcast_tensors(
        found[1] / found[0], *(torch.as_tensor(part).to(mass) for part in assembly.proportional(members.damping))
    )
    every = torch.stack([part.reshape(-1) for part in parts])
    return modes.shape, SharedModes(modes.eigenvalue, whole, torch.stack(every.aminmax(dim=1), dim=-1))
