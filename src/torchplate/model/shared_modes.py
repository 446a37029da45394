"""Plates that share their modes: receptances of a whole population without solving one eigenproblem.

Where Young's modulus, thickness or density change, every element changes alike: K_plate = e K₀ and M_plate = m M₀. The
eigenvectors of such plates are those of the nominal one. With damping in proportion to K and M,

    Z(s) = eκ (K₀ − z M₀) + Uᵀ D U,    z = −mμ / eκ,    κ = 1 + iβ + sb, μ = iη + sa + s²,

so all plates at all lines read one and the same function G(z) = Σ φφᵀ / (λ − z) of one complex number, and no `eigh` is
needed. Springs, dashpots and masses at places (D, a few rows U) are attached to it one after the other,

    G ← G − g u D / (1 + g_uu D) gᵀ,    g = G u,

(Sherman and Morrison, Annals of Mathematical Statistics 21 (1950) 124; in dynamics the receptance coupling of Bishop
and Johnson, The Mechanics of Vibration, 1960). The nominal springs and masses are already in K₀ and M₀.

For a block of lines, the modes near it are summed one by one. All others together vary slowly with z there, and each is
a Chebyshev series that is known in closed form: 1 / (a − t) = 2 / √(a² − 1) · Σ' ρ⁻ᵏ T_k(t), ρ = a + √(a² − 1)
(Mason and Handscomb, Chebyshev Polynomials, 2003, section 5.2). So most modes cost nothing for each line.

Everything here is a smooth formula of theta in plain torch operations: its derivatives of any order are torch's own.
"""

from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from torchplate.model.frf import joined, stack_rows
from torchplate.model.modes import solve_modes
from torchplate.plate import Assembly, Plan
from torchplate.plate.assemble import concatenate

# A mode is far from a block of lines if its ρ is at least RHO: N_TERM terms then leave RHO^−N_TERM, 6e-8, of what it
# adds to the FRF. The series is for z near the real axis: damping widens the block by WIDENED times its Im z.
RHO = 4.0
N_TERM = 12
WIDENED = 8.0
# Attaching terms one after the other costs the square of their number; with more, one `eigh` each is cheaper.
MOST_TERMS = 12
# Coefficients of members agree to rounding, or they are not multiples of the nominal ones.
ALIKE = 1e-12
# Numbers of an array [mode, member, line] that a CPU's cache holds beside what is made of them.
CACHED = 2**18


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

    def stiffness(
        self, z: Complex[Tensor, "*batch n_frequency"], rate: Complex[Tensor, "*batch n_frequency"]
    ) -> Complex[Tensor, "n_term *batch n_frequency"]:
        """D / eκ = k/e − z m/m + c s/eκ, the last factor given as `rate`."""
        total = z.new_zeros(self.row.shape[-2], *(1,) * z.ndim)
        for value, weight in zip(self[1:], (-z, None, rate), strict=True):
            if value is not None:
                # [n_term, *batch, 1], also where all members have the same value.
                own = value.expand(*(1,) * (z.ndim - value.ndim), *value.shape).movedim(-1, 0)[..., None]
                total = total + (own if weight is None else own * weight)
        return total


class SharedModes(nn.Module):
    """Receptances of every plate that is the nominal one times a stiffness and a mass factor, with terms attached.

    Args:
        eigenvalue: λ of (K₀, M₀) in the assembly's basis, whose vectors are the modes, lowest first [rad²/s²].
        nominal: what K₀ and M₀ were assembled from.
    """

    eigenvalue: Tensor
    stiffness: Tensor
    mass: Tensor
    spring: Tensor
    lump: Tensor

    def __init__(self, eigenvalue: Float[Tensor, " n"], nominal: Nominal) -> None:
        super().__init__()
        # One entry tells the factor of all: the largest is never one that vanishes.
        self.entry = divmod(int(nominal.stiffness.abs().argmax()), nominal.stiffness.shape[-1])
        parts = {
            "eigenvalue": eigenvalue,
            "stiffness": nominal.stiffness[self.entry],
            "mass": nominal.mass.flatten()[0],
            "spring": nominal.spring,
            "lump": nominal.lump,
        }
        for name, value in parts.items():
            self.register_buffer(name, value, persistent=False)

    def receptance(
        self,
        assembly: Assembly,
        plan: Plan,
        laplace: Complex[Tensor, "*#batch n_frequency"],
        left: Float[Tensor, "*#batch n_left n"],
        right: Float[Tensor, "*#batch n_right n"],
    ) -> Complex[Tensor, "*batch n_frequency n_left n_right"]:
        """α [m/N].

        Args:
            assembly: in the basis of the modes.
            plan: what the effects make of the members.
            laplace: s [1/s].
            left: modal deflections at the responses [1/√kg].
            right: modal deflections at the references [1/√kg].
        """
        stiffness, mass = _coefficients(assembly, plan)
        e, m = stiffness[..., self.entry[0], self.entry[1]] / self.stiffness, mass[..., 0, 0] / self.mass
        damping = assembly.proportional(plan.damping)
        attached = self._attached(assembly, plan, e, m)
        sides = [stack_rows(attached.row, side) for side in (left, right)]
        pairs = (sides[0][..., :, None, :] * sides[1][..., None, :, :]).flatten(-3, -2)
        shape = sides[0].shape[-2], sides[1].shape[-2]
        parts = []
        for s in laplace.split(self._lines_at_once(e.numel()), dim=-1):
            kappa, mu = damping.at(s)
            flexibility = 1 / (e[..., None] * kappa)
            z = -m[..., None] * mu * flexibility
            found = self._green(z, pairs).unflatten(0, shape)
            for force in attached.stiffness(z, s * flexibility):
                column, row = found[1:, :1], found[:1, 1:] * (force / (1 + force * found[0, 0]))
                found = torch.addcmul(found[1:, 1:], column, row, value=-1)
            parts.append(found * flexibility)
        return joined(parts, -1).movedim((0, 1), (-2, -1))

    def _lines_at_once(self, n_member: int) -> int:
        return max(1, CACHED // (n_member * len(self.eigenvalue)))

    def _attached(self, assembly: Assembly, plan: Plan, e: Tensor, m: Tensor) -> Attached:
        """All terms; a mass over m and a spring over e, so that what M₀ and K₀ hold of them is the same for all."""
        rows = [self.eigenvalue.new_zeros(0, len(self.eigenvalue))]
        values: list[list[Tensor]] = [[], [], []]
        first = 0
        for term in plan.terms:
            here = slice(first, first := first + term.vector.shape[-2])
            rows.append(assembly.rows(term.vector))
            held = self.lump[here], self.spring[here], torch.zeros_like(self.spring[here])
            for total, value, over, part in zip(values, term[1:], (m, e, torch.ones_like(e)), held, strict=True):
                total.append(-part if value is None else value / over[..., None] - part)
        used = [any(term[kind] is not None for term in plan.terms) for kind in (1, 2, 3)]
        together = [concatenate(total, 1) if some else None for total, some in zip(values, used, strict=True)]
        return Attached(concatenate(rows, 2), *together)

    def _green(
        self, z: Complex[Tensor, "*batch n_frequency"], pairs: Float[Tensor, "*#batch n_pair n"]
    ) -> Complex[Tensor, "n_pair *batch n_frequency"]:
        """Σ pair / (λ − z): one real product where all members have the same rows."""
        x, y, count = z.real.flatten(), z.imag.flatten(), len(self.eigenvalue)
        disc = _disc(z)
        first, last = (0, count) if disc is None else self._near(*disc)
        apart = self.eigenvalue[first:last, None] - x
        scale = 1 / torch.addcmul(y * y, apart, apart)
        features, weight = torch.complex(apart * scale, y * scale), pairs[..., first:last]
        if disc is not None and last - first < count:
            centre, half = disc
            beyond = torch.cat([pairs[..., :first], pairs[..., last:]], dim=-1)
            eigenvalue = torch.cat([self.eigenvalue[:first], self.eigenvalue[last:]])
            weight = torch.cat([weight, beyond @ chebyshev_series((eigenvalue - centre) / half) / half], dim=-1)
            features = torch.cat([features, *(row[None] for row in chebyshev_values((z.flatten() - centre) / half))])
        # Complex numbers are pairs of real ones in memory: one real product serves both parts.
        flat = torch.view_as_real(features)
        if weight.ndim == 2:
            product = (weight @ flat.flatten(1)).unflatten(-1, (*z.shape, 2))
        else:
            apart_members = flat.unflatten(1, z.shape).movedim(0, -3)
            product = (weight @ apart_members.flatten(-2)).unflatten(-1, (-1, 2)).movedim(-3, 0)
        return torch.view_as_complex(product.contiguous())

    def _near(self, centre: float, half: float) -> tuple[int, int]:
        """The modes, first and beyond the last, that have to be summed one by one."""
        reach = 0.5 * (RHO + 1 / RHO) * half
        ends = self.eigenvalue.new_tensor([centre - reach, centre + reach])
        first, last = torch.searchsorted(self.eigenvalue, ends).tolist()
        return first, last


def _disc(z: Complex[Tensor, "*batch n"]) -> tuple[float, float] | None:
    """Centre and half width of the stretch of the real axis that z is near to; None under `vmap`: nobody may look."""
    try:
        x, y = z.detach().real, z.detach().imag
        low, high, off = float(x.amin()), float(x.amax()), float(y.abs().amax())
    except RuntimeError:
        return None
    return 0.5 * (low + high), max(0.5 * (high - low), WIDENED * off, 1e-3 * abs(high))


def chebyshev_series(a: Float[Tensor, " n"]) -> Float[Tensor, "n n_term"]:
    """Coefficients of 1 / (a − t) in T_k(t), |a| > 1."""
    root = (a * a - 1).sqrt()
    order = torch.arange(N_TERM).to(a)
    series = (a.sign() / (a.abs() + root))[:, None] ** order * (2 * a.sign() / root)[:, None]
    return torch.where(order == 0, 0.5 * series, series)


def chebyshev_values(t: Complex[Tensor, " n"]) -> list[Complex[Tensor, " n"]]:
    """T_0 … T_(N_TERM − 1) at t, by their recurrence."""
    values, twice = [torch.ones_like(t), t], 2 * t
    while len(values) < N_TERM:
        values.append(twice * values[-1] - values[-2])
    return values


def _coefficients(assembly: Assembly, plan: Plan) -> tuple[Tensor, Tensor]:
    return (
        assembly.stiffness_coefficient(plan.section.rigidity, plan.geometry),
        assembly.mass_coefficient(plan.section.areal_mass, plan.geometry),
    )


def find_shared_modes(assembly: Assembly, nominal: Plan, members: Plan) -> tuple[Tensor, SharedModes] | None:
    """The modes that all members share, as combinations of the assembly's vectors [n, n]; None where they share none.

    Args:
        assembly: in all dofs or in a basis.
        nominal: one member.
        members: a batch of them, wide enough to show what moves.
    """
    if members.section.loss_factor is not None or sum(term.vector.shape[-2] for term in members.terms) > MOST_TERMS:
        return None
    coefficients = [_coefficients(assembly, plan) for plan in (nominal, members)]
    for one, many in zip(*coefficients, strict=True):
        largest = one.abs().flatten().argmax()
        factor = many.flatten(-2)[..., largest, None] / one.flatten()[largest]
        error = (many.flatten(-2) - factor * one.flatten()).abs()
        if bool((error > ALIKE * (factor * one.flatten()[largest]).abs()).any()):
            return None
    stiffness = assembly.stiffness(nominal.section.rigidity, nominal.geometry)
    mass = assembly.mass(nominal.section.areal_mass, nominal.geometry)
    spring, lump = [], []
    for one, many in zip(nominal.terms, members.terms, strict=True):
        # A term whose place is searched belongs to no common K₀ and M₀.
        fixed = many.vector.ndim == one.vector.ndim
        nothing = stiffness.new_zeros(one.vector.shape[-2])
        spring.append(one.stiffness if fixed and one.stiffness is not None else nothing)
        lump.append(one.mass if fixed and one.mass is not None else nothing)
        row = assembly.rows(one.vector)
        stiffness, mass = stiffness + row.mT @ (spring[-1][:, None] * row), mass + row.mT @ (lump[-1][:, None] * row)
    modes = solve_modes(stiffness, mass)
    nothing = stiffness.new_zeros(0)
    whole = Nominal(*coefficients[0], torch.cat([nothing, *spring]), torch.cat([nothing, *lump]))
    return modes.shape, SharedModes(modes.eigenvalue, whole)
