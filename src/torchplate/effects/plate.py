"""The bare plate: the first effect, on which all others act."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Effect, Interval, Parameter, Value, positive
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class Plate(Effect):
    """A uniform isotropic Kirchhoff plate: D = E h³ / (12 (1 − ν²)), areal mass ρh."""

    parameters = {
        "youngs_modulus": Parameter("Pa", "Young's modulus E", positive),
        "poisson_ratio": Parameter("-", "Poisson's ratio ν", Interval(-0.99, 0.499)),
        "density": Parameter("kg/m³", "mass per volume ρ", positive),
        "thickness": Parameter("m", "thickness h", positive),
    }
    acts_on = frozenset({"section"})
    shows = "All natural frequencies scale with h √(E/ρ); Poisson's ratio parts bending from torsion modes."
    source = "seed paper, Eq. 12–14; Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959)"

    def section(self, mesh: Mesh, section: Section | None, value: Value) -> Section:
        """The section of the bare plate; there is none before it."""
        young, poisson, density, thickness = (value[name][..., None] for name in self.parameters)
        one = torch.ones_like(young)
        return Section(young, one, poisson, one, density, thickness, one)
