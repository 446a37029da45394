"""The bare plate: the first effect, on which all others act."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Effect, Value
from torchplate.effects.parameter import Interval, Parameter, Prior, positive
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class Plate(Effect):
    """A uniform isotropic Kirchhoff plate: D = E h³ / (12 (1 − ν²)), areal mass ρh."""

    parameters = {
        "youngs_modulus": Parameter(
            "Pa", "Young's modulus E", positive, prior=Prior(0.8, 1.25, relative_to="youngs_modulus")
        ),
        "poisson_ratio": Parameter(
            "-", "Poisson's ratio ν", Interval(-0.99, 0.499), prior=Prior(0.5, 1.5, relative_to="poisson_ratio")
        ),
        "density": Parameter("kg/m³", "mass per volume ρ", positive, prior=Prior(0.8, 1.2, relative_to="density")),
        "thickness": Parameter("m", "thickness h", positive, prior=Prior(0.9, 1.1, relative_to="thickness")),
    }
    acts_on = frozenset({"section"})
    shows = "All natural frequencies scale with h √(E/ρ); Poisson's ratio parts bending from torsion modes."
    source = "seed paper, Eq. 12–14; Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959)"
    stage = 0

    def section(self, mesh: Mesh, section: Section | None, value: Value) -> Section:
        """The section of the bare plate; there is none before it."""
        young, poisson, density, thickness = (value[name][..., None] for name in self.parameters)
        one = torch.ones_like(young)
        return Section(young, one, poisson, one, density, thickness, one[..., None])
