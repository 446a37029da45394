"""What a plate is made of: the few quantities that every effect changes or adds."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.plate.added_mass import AddedMass
from torchplate.plate.power_law import power_law

# Natural frequency of a sprung mass of zero [rad/s]: far above any band, and below the highest of a fine mesh.
STIFFEST = 2 * math.pi * 2e5


class Geometry(NamedTuple):
    """Sides of the plate [m], one pair for each member of the batch."""

    length_x: Float[Tensor, "*batch"]
    length_y: Float[Tensor, "*batch"]


class Section(NamedTuple):
    """What each element is made of; a last dimension of 1 means the same everywhere.

    Young's modulus is the geometric mean √(E_x E_y) and Poisson's ratio √(ν_x ν_y), so that an isotropic plate is the
    case `young_ratio` = `shear_factor` = 1 and a change of one quantity leaves the others as they are.
    """

    youngs_modulus: Float[Tensor, "*batch n_element"]  # √(E_x E_y) [Pa]
    young_ratio: Float[Tensor, "*batch n_element"]  # E_y / E_x [-]
    poisson_ratio: Float[Tensor, "*batch n_element"]  # √(ν_x ν_y) [-]
    shear_factor: Float[Tensor, "*batch n_element"]  # G over E / (2 (1 + ν)) [-]
    density: Float[Tensor, "*batch n_element"]  # [kg/m³]
    thickness: Float[Tensor, "*batch n_element"]  # [m]
    # D₁₁, D₂₂, D₁₂ and D₃₃ over those of the sound section; a last dimension of 1 means the same for all four [-].
    stiffness_factor: Float[Tensor, "*batch n_element n_entry"]
    # Hysteretic loss factors of the same four, beside that of the whole model [-].
    loss_factor: Float[Tensor, "*batch n_element n_entry"] | None = None
    # From the side x to the axis of E_x, positive towards the side y [rad]; None where they are the same.
    grain_angle: Float[Tensor, "*batch n_element"] | None = None
    # ∫ ξ^p η^q of what stiffness_factor is more at a place in an element than its mean; see `cut_elements` [-].
    uneven: Float[Tensor, "*batch n_element n_entry n_power"] | None = None
    # The same of stiffness_factor · loss_factor.
    uneven_loss: Float[Tensor, "*batch n_element n_entry n_power"] | None = None
    # The same of what density is more at a place in an element than its mean, powers up to 6 [kg/m³].
    uneven_density: Float[Tensor, "*batch n_element 49"] | None = None

    @property
    def areal_mass(self) -> Float[Tensor, "*batch n_element"]:
        """Mass per area ρh [kg/m²]."""
        return self.density * self.thickness

    @property
    def rigidity(self) -> Float[Tensor, "*batch n_element 3 3"]:
        """Bending rigidity: moments = D curvatures, curvatures (−w,xx, −w,yy, −2w,xy) [N m].

        D = h³/12 · [[E_x, ν√(E_x E_y), 0], [ν√(E_x E_y), E_y, 0], [0, 0, G(1 − ν²)]] / (1 − ν²), and TᵀDT where the
        grain is turned; see `turned`.
        Source: seed paper, Eq. 12, for E_x = E_y; Lekhnitskii, Anisotropic Plates (1968), for the orthotropic plate.
        """
        return self._matrix(self.stiffness_factor)

    @property
    def lossy_rigidity(self) -> Float[Tensor, "*batch n_element 3 3"]:
        """Rigidity times the elements' own loss factors [N m]; zero where they have none."""
        return self._matrix(self.stiffness_factor * (0.0 if self.loss_factor is None else self.loss_factor))

    def passive(self, common: Float[Tensor, "*#batch"] | float) -> "Section":
        """With losses along the two directions by which no motion gains energy.

        Where one loss is beyond (1 + √(1 − ν²))² / ν² times the other, 40 times at ν = 0.3, a plate of which D₁₂ loses
        their mean would gain energy in motions that bend it both ways. There ν in the compliance loses no more than
        the lesser loss allows, and D₁₁, D₂₂ and D₁₂ follow: strips lose as before.

        Args:
            common: loss factor of the whole model, which is lost beside the elements' own [-].
        """
        if self.loss_factor is None or self.loss_factor.shape[-1] == 1:
            return self
        x, y, mean, twist = self.loss_factor.unbind(-1)
        common = torch.as_tensor(common).to(x)[..., None]
        # −S″ = [[η_x, −ν m], [−ν m, η_y]] in units of √(E_x E_y) is definite as long as m ≤ √(η_x η_y) / ν: m is the
        # mean, and below that bound the line from zero to where the mean meets it. D″ is −D S″ D.
        square = self.poisson_ratio**2
        lesser = torch.minimum(x, y) + common
        beyond = (square * (mean + common) - (1 + (1 - square).sqrt()) * lesser).clamp(min=0.0)
        more = 2 * beyond / (1 - square)
        cross = mean + (1 + square) / (1 - square) * beyond / square.clamp(min=torch.finfo(square.dtype).tiny)
        return self._replace(loss_factor=torch.stack(torch.broadcast_tensors(x + more, y + more, cross, twist), dim=-1))

    def lossier(self, more: Float[Tensor, "*#batch #n_element #n_entry"]) -> "Section":
        """With so much more of the elements' own loss factors [-], in elements that are not the same all over, too."""
        loss = more if self.loss_factor is None else self.loss_factor + more
        if self.uneven is None:
            return self._replace(loss_factor=loss)
        lost = self.uneven * more[..., None]
        return self._replace(
            loss_factor=loss, uneven_loss=lost if self.uneven_loss is None else self.uneven_loss + lost
        )

    @property
    def sound_entries(self) -> Float[Tensor, "*batch n_element 4"]:
        """D₁₁, D₂₂, D₁₂ and D₃₃ along the grain, without what `stiffness_factor` makes of them [N m]."""
        mean = self.youngs_modulus * self.thickness.pow(3) / 12
        plane = mean / (1 - self.poisson_ratio.square())
        root = self.young_ratio.sqrt()
        shear = self.shear_factor * mean / (2 * (1 + self.poisson_ratio))
        sound = torch.broadcast_tensors(plane / root, plane * root, plane * self.poisson_ratio, shear)
        return torch.stack(sound, dim=-1)

    @property
    def sound_parts(self) -> Float[Tensor, "4 *batch n_element 3 3"]:
        """What D₁₁, D₂₂, D₁₂ and D₃₃ each bring into it [N m]."""
        one = torch.eye(4).to(self.stiffness_factor)
        return torch.stack([self._matrix(part[None]) for part in one])

    def _matrix(self, factor: Float[Tensor, "*#batch _ n_entry"]) -> Float[Tensor, "*batch n_element 3 3"]:
        """The sound rigidity, its entries times factors."""
        along_x, along_y, cross, twist = (self.sound_entries * factor).unbind(-1)
        zero = torch.zeros_like(cross)
        flat = torch.stack([along_x, cross, zero, cross, along_y, zero, zero, zero, twist], dim=-1)
        straight = flat.unflatten(-1, (3, 3))
        return straight if self.grain_angle is None else turned(straight, self.grain_angle)


def turned(
    rigidity: Float[Tensor, "*#batch n_element 3 3"], angle: Float[Tensor, "*#batch #n_element"]
) -> Float[Tensor, "*batch n_element 3 3"]:
    """TᵀDT: the rigidity in the plate's axes of a material whose own are turned.

    T takes curvatures (−w,xx, −w,yy, −2w,xy) to those along and across the grain: with c = cos, s = sin of the angle
    [[c², s², cs], [s², c², −cs], [−2cs, 2cs, c² − s²]]. Source: Lekhnitskii, Anisotropic Plates (1968), on the change
    of axes.

    Args:
        rigidity: along and across the grain [N m].
        angle: from the side x to the grain [rad].
    """
    cos, sin = angle.cos(), angle.sin()
    both, along, across = cos * sin, cos**2, sin**2
    rows = [along, across, both, across, along, -both, -2 * both, 2 * both, along - across]
    turn = torch.stack(rows, dim=-1).unflatten(-1, (3, 3))
    return turn.mT @ rigidity @ turn


class Sprung(NamedTuple):
    """Masses that hang on a spring and a dashpot beside it, one for each term; the other end is on the plate.

    With no coordinate of its own such a mass is a dynamic stiffness at its place,

        D(s) = s² m (k + sc) / (k + sc + s² m)

    (Den Hartog, Mechanical Vibrations, 4th ed. 1956, section 3.2). Loss factors of the whole model do not act on it.
    """

    mass: Float[Tensor, "*batch n_term"]  # m [kg]
    stiffness: Float[Tensor, "*batch n_term"]  # k [N/m]
    viscous: Float[Tensor, "*batch n_term"]  # c [N s/m]

    def force(self, laplace: Complex[Tensor, "*#batch n_frequency"]) -> Complex[Tensor, "*batch n_term n_frequency"]:
        """D(s) [N/m]."""
        s = laplace[..., None, :]
        mass, stiffness, viscous = (part[..., None] for part in self)
        link, inertia = stiffness + s * viscous, s**2 * mass
        total = link + inertia
        # Without a dashpot D is infinite at √(k/m), and without anything it is 0/0: a rounding of both away from that.
        apart = torch.finfo(mass.dtype).eps * (stiffness + s.abs() ** 2 * mass) + torch.finfo(mass.dtype).tiny
        return inertia * link / torch.where(total == 0, apart.to(total), total)


class Local(NamedTuple):
    """Terms uᵀu times a coefficient: masses, springs and dashpots at places.

    `vector` gives the deflection there from the dofs of the mesh, so that no effect ever builds a whole matrix.
    """

    vector: Float[Tensor, "*batch n_term n_dof"]
    mass: Float[Tensor, "*batch n_term"] | None = None  # [kg]
    stiffness: Float[Tensor, "*batch n_term"] | None = None  # [N/m]
    viscous: Float[Tensor, "*batch n_term"] | None = None  # [N s/m]
    sprung: Sprung | None = None

    def dynamic_stiffness(
        self, laplace: Complex[Tensor, "*#batch n_frequency"]
    ) -> Complex[Tensor, "*batch n_term n_frequency"]:
        """D(s) = k + sc + s²m of each term, and of what hangs there [N/m]."""
        s = laplace[..., None, :]
        parts = [
            one[..., None] * s**power
            for power, one in enumerate((self.stiffness, self.viscous, self.mass))
            if one is not None
        ]
        if self.sprung is not None:
            parts.append(self.sprung.force(laplace))
        return sum(parts, torch.zeros_like(s))


class Proportional(NamedTuple):
    """Damping in proportion to the K and M of the whole model, supports and added masses included.

    Z(s) = K (1 + iβ + sb) + M (iη + sa + s²) + s C + iH, with β `stiffness_loss_factor` [-], η `mass_loss_factor`
    [1/s²], a `mass_coefficient` [1/s], b `stiffness_coefficient` [s]. Source: seed paper, Eq. 17–18; Rayleigh for a, b.
    `loss_exponent` n [-] makes iβ a power of the frequency, with its modulus: see `power_law`. Exponents of several
    effects add, as their powers multiply.
    """

    stiffness_loss_factor: Float[Tensor, "*batch"] | float = 0.0
    mass_loss_factor: Float[Tensor, "*batch"] | float = 0.0
    mass_coefficient: Float[Tensor, "*batch"] | float = 0.0
    stiffness_coefficient: Float[Tensor, "*batch"] | float = 0.0
    loss_exponent: Float[Tensor, "*batch"] | float = 0.0

    def at(
        self, laplace: Complex[Tensor, "*#batch n_frequency"]
    ) -> tuple[Complex[Tensor, "*#batch #n_frequency"], Complex[Tensor, "*#batch n_frequency"]]:
        """What K and M are times at each s: κ = 1 + iβ + sb, iβ a power of s with an exponent, and μ = iη + sa + s².

        What no effect brings is the number 0 here and costs nothing: without b, κ is the same at all lines.
        """
        beta, eta, a, b = (value[..., None] if isinstance(value, Tensor) else value for value in self[:4])
        kappa, mu = laplace.new_ones(1) + 1j * beta, laplace.square()
        if (dispersion := self.dispersion(laplace)) is not None:
            kappa = kappa + dispersion
        if isinstance(b, Tensor) or b:
            kappa = kappa + laplace * b
        if isinstance(a, Tensor) or a:
            mu = mu + laplace * a
        if isinstance(eta, Tensor) or eta:
            mu = mu + 1j * eta
        return kappa, mu

    def dispersion(
        self, laplace: Complex[Tensor, "*#batch n_frequency"]
    ) -> Complex[Tensor, "*#batch n_frequency"] | None:
        """What the exponent adds to κ; None without one."""
        exponent, beta = self.loss_exponent, self.stiffness_loss_factor
        if not isinstance(exponent, Tensor) and not exponent:
            return None
        beta = beta[..., None] if isinstance(beta, Tensor) else beta
        return beta * (power_law(exponent, laplace) - 1j)


class Plan(NamedTuple):
    """Everything the effects say of a batch of members, before any matrix is built."""

    section: Section
    geometry: Geometry
    terms: list[Local]
    damping: list[Proportional]
    added: Sequence[AddedMass] = ()


class System(NamedTuple):
    """Matrices of one model for a batch of members, held dofs left out; dashpots stay rows and coefficients."""

    mass: Float[Tensor, "*batch n n"]  # M [kg]
    stiffness: Float[Tensor, "*batch n n"]  # K, springs included [N/m]
    dashpot: Float[Tensor, "*batch n_dashpot n"]  # deflection there over the dofs [-]
    viscous: Float[Tensor, "*batch n_dashpot"]  # coefficients [N s/m]
    hysteretic: Float[Tensor, "*batch n n"] | None  # K of the elements times their own loss factors [N/m]
    proportional: Proportional
    # Masses on springs: deflection there over the dofs [-], and what hangs there; None where nothing does.
    carrier: Float[Tensor, "*batch n_sprung n"] | None = None
    sprung: Sprung | None = None

    @property
    def attached(self) -> Float[Tensor, "*batch n_attached n"]:
        """Deflection at the dashpots, then at the sprung masses, over the dofs."""
        return self.dashpot if self.carrier is None else concatenate([self.dashpot, self.carrier], 2)

    def force(
        self, laplace: Complex[Tensor, "*#batch n_frequency"]
    ) -> Complex[Tensor, "*batch n_attached n_frequency"]:
        """Dynamic stiffness of each row of `attached` [N/m]: s c of a dashpot, D(s) of a sprung mass."""
        own = laplace[..., None, :] * self.viscous[..., None]
        return own if self.sprung is None else concatenate([own, self.sprung.force(laplace)], 2)

    def undamped(self) -> tuple[Float[Tensor, "*#batch n_all n_all"], Float[Tensor, "*#batch n_all n_all"]]:
        """K and M with the motion of the sprung masses as further coordinates, after the dofs.

        A mass may be zero: so that its coordinate still has a natural frequency, the least inertia of the link between
        it and the plate is k / `STIFFEST`², which the plate does not feel where the mass is zero.
        """
        if self.sprung is None or self.carrier is None:
            return self.stiffness, self.mass
        mass, stiffness = self.sprung.mass, self.sprung.stiffness
        own = torch.eye(self.carrier.shape[-2]).to(self.carrier)
        zero = self.carrier.new_zeros(own.shape[0], self.stiffness.shape[-1])
        link, hung = concatenate([self.carrier, -own], 1), concatenate([zero, own], 1)
        n = len(own)
        found = []
        for matrix, of_link, of_mass in (
            (self.stiffness, stiffness, None),
            (self.mass, stiffness / STIFFEST**2, mass),
        ):
            whole = torch.nn.functional.pad(matrix, (0, n, 0, n)) + link.mT @ (of_link[..., None] * link)
            found.append(whole if of_mass is None else whole + hung.mT @ (of_mass[..., None] * hung))
        return found[0], found[1]


def concatenate(parts: Sequence[Tensor], n_last: int) -> Tensor:
    """Parts put together along the first of their last `n_last` dimensions, whatever batch each has."""
    if len(parts) == 1:
        return parts[0]
    batch = common_shape(*(part.shape[:-n_last] for part in parts))
    return torch.cat([part.expand(*batch, *part.shape[-n_last:]) for part in parts], dim=-n_last)


def common_shape(*shapes: Sequence[int]) -> torch.Size:
    """What all of some shapes broadcast to. `torch.broadcast_shapes` imports sympy: a third of a second of each run."""
    return torch.Size(np.broadcast_shapes(*map(tuple, shapes)))
