"""What is added to an assembly that its mesh does not give: the error of the mesh, and a plate that is not even."""

from typing import NamedTuple

from jaxtyping import Bool, Float
from torch import Tensor

from torchplate.plate.section import Geometry

# Rigidity or mass of an element over the mean below which there is a hole: patches that are searched keep a tenth.
LEAST = 0.1


class Correction(NamedTuple):
    """Rᵀ C R, which the stiffness of one plate lacks, and S R u, which its deflection u lacks.

    Other plates lack the stiffness in proportion to their rigidity.

    Attributes:
        rows: R, over the free dofs.
        stiffness: C.
        shape: S.
        rigidity: √(D₁₁ D₂₂) / (Lx Ly) of the plate it belongs to, mean over the elements [N/m].
        loss: what the matrix of the elements' own losses lacks, in the place of C; None where that is in proportion.
        lossy: of that plate's rigidities times these losses, as `rigidity` is.
    """

    rows: Float[Tensor, "n_row n_free"]
    stiffness: Float[Tensor, "n_row n_row"]
    shape: Float[Tensor, "n_free n_row"]
    rigidity: Float[Tensor, ""]
    loss: Float[Tensor, "n_row n_row"] | None = None
    lossy: Float[Tensor, ""] | None = None

    def lost(
        self, lossy_rigidity: Float[Tensor, "*#batch n_element 3 3"], geometry: Geometry
    ) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "n_row n_row"]]:
        """What the losses of other plates lack: a matrix, and what it is times."""
        if self.loss is None or self.lossy is None:
            return self.scale(lossy_rigidity, geometry), self.stiffness
        return self.measure(lossy_rigidity, geometry) / self.lossy.to(lossy_rigidity), self.loss

    def scale(self, rigidity: Float[Tensor, "*#batch n_element 3 3"], geometry: Geometry) -> Float[Tensor, "*batch"]:
        """The correction of other plates over that of this one."""
        return self.measure(rigidity, geometry) / self.rigidity.to(rigidity)

    @staticmethod
    def measure(rigidity: Float[Tensor, "*#batch n_element 3 3"], geometry: Geometry) -> Float[Tensor, "*batch"]:
        """√(D₁₁ D₂₂) / (Lx Ly), mean over the elements [N/m]."""
        mean = (rigidity[..., 0, 0] * rigidity[..., 1, 1]).sqrt().mean(-1)
        return mean / (geometry.length_x * geometry.length_y)


class Unevenness(NamedTuple):
    """What a plate that is not the same everywhere has beside a uniform one, in the coordinates of an assembly.

    Other plates have it in proportion to their rigidity and to their mass. One with a hole has none of it: what of it
    would be inside is not known, and no part of a plate weighs less than nothing.

    Attributes:
        stiffness: more of it.
        mass: likewise.
        rigidity: √(D₁₁ D₂₂) / (Lx Ly) of the plate it belongs to, mean over the elements [N/m].
        heavy: mass of that plate [kg].
    """

    stiffness: Float[Tensor, "n n"]
    mass: Float[Tensor, "n n"]
    rigidity: Float[Tensor, ""]
    heavy: Float[Tensor, ""]

    @staticmethod
    def goes_for(of_elements: Float[Tensor, "*#batch n_element"]) -> Bool[Tensor, "*batch"]:
        """Whether plates have it, by the rigidity or the mass of their elements: not those with a hole."""
        return of_elements.amin(-1) >= LEAST * of_elements.mean(-1)

    @staticmethod
    def measure(areal_mass: Float[Tensor, "*#batch n_element"], geometry: Geometry) -> Float[Tensor, "*batch"]:
        """Mass of a plate [kg]."""
        return areal_mass.mean(-1) * geometry.length_x * geometry.length_y
