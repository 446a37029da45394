"""What a plate is made of: the few quantities that every effect changes or adds."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.plate.added_mass import AddedMass
from torchplate.plate.power_law import power_law


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

    @property
    def areal_mass(self) -> Float[Tensor, "*batch n_element"]:
        """Mass per area ρh [kg/m²]."""
        return self.density * self.thickness

    @property
    def rigidity(self) -> Float[Tensor, "*batch n_element 3 3"]:
        """Bending rigidity: moments = D curvatures, curvatures (−w,xx, −w,yy, −2w,xy) [N m].

        D = h³/12 · [[E_x, ν√(E_x E_y), 0], [ν√(E_x E_y), E_y, 0], [0, 0, G(1 − ν²)]] / (1 − ν²).
        Source: seed paper, Eq. 12, for E_x = E_y; Lekhnitskii, Anisotropic Plates (1968), for the orthotropic plate.
        """
        return self._matrix(self.stiffness_factor)

    @property
    def lossy_rigidity(self) -> Float[Tensor, "*batch n_element 3 3"]:
        """Rigidity times the elements' own loss factors [N m]; zero where they have none."""
        return self._matrix(self.stiffness_factor * (0.0 if self.loss_factor is None else self.loss_factor))

    def _matrix(self, factor: Float[Tensor, "*#batch _ n_entry"]) -> Float[Tensor, "*batch n_element 3 3"]:
        """The sound rigidity, its entries times factors."""
        mean = self.youngs_modulus * self.thickness**3 / 12
        plane = mean / (1 - self.poisson_ratio**2)
        root = self.young_ratio.sqrt()
        shear = self.shear_factor * mean / (2 * (1 + self.poisson_ratio))
        sound = torch.broadcast_tensors(plane / root, plane * root, plane * self.poisson_ratio, shear)
        along_x, along_y, cross, twist = (torch.stack(sound, dim=-1) * factor).unbind(-1)
        zero = torch.zeros_like(cross)
        flat = torch.stack([along_x, cross, zero, cross, along_y, zero, zero, zero, twist], dim=-1)
        return flat.unflatten(-1, (3, 3))


class Local(NamedTuple):
    """Terms uᵀu times a coefficient: masses, springs and dashpots at places.

    `vector` gives the deflection there from the dofs of the mesh, so that no effect ever builds a whole matrix.
    """

    vector: Float[Tensor, "*batch n_term n_dof"]
    mass: Float[Tensor, "*batch n_term"] | None = None  # [kg]
    stiffness: Float[Tensor, "*batch n_term"] | None = None  # [N/m]
    viscous: Float[Tensor, "*batch n_term"] | None = None  # [N s/m]


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
        kappa, mu = laplace.new_ones(1) + 1j * beta, laplace**2
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
