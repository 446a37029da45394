"""A thickness that wanders over the plate in long waves, as a rolled, cast or planed one does."""

import math
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Interval, Parameter
from torchplate.plate import Mesh, Section

# Half waves along x and y, the longest five of zero mean.
TERMS = ((1, 0), (0, 1), (1, 1), (2, 0), (0, 2))
# So small that no sum of all makes a plate of no thickness: their largest values add up to 8.8.
AMPLITUDE = Interval(-0.11, 0.11)


@dataclass(frozen=True)
class ThicknessField(Effect):
    """h(x, y) = h (1 + Σ a_ij φ_ij), φ_ij = √(2 or 4) cos(iπx) cos(jπy), x and y relative, constant over each element.

    Each term has zero mean and a root mean square of one, so that a_ij is the scatter that it makes: 0.005 to 0.02 in
    all is what a calliper finds on rolled metal and planed wood. Taper is `thickness_taper`. No candidate of a search
    for what is missing, since such a search holds the wandering of every plate's thickness for a nuisance anyway; give
    it as known or searched where the thickness was measured, or is to be.
    """

    parameters = {
        f"a{i}{j}": Parameter(
            "-", f"root mean square of the term of {i} half waves along x and {j} along y, over h", AMPLITUDE, 0.0
        )
        for i, j in TERMS
    }
    check = Check(2, "measure the thickness with a calliper on a grid of points, to 0.01 mm")
    acts_on = frozenset({"section"})
    shows = "Every mode moves by its own per cent or so and leans a little; no one place or quantity explains all."
    source = "Leissa, Vibration of Plates, NASA SP-160 (1969), plates of variable thickness"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The thickness of each element, at its centre."""
        x, y = (math.pi * mesh.element_place.to(value["a10"])).unbind(-1)
        relative = torch.ones_like(x)
        for (i, j), name in zip(TERMS, self.parameters, strict=True):
            scale = math.sqrt(2.0 ** ((i > 0) + (j > 0)))
            relative = relative + value[name][..., None] * scale * (i * x).cos() * (j * y).cos()
        return section._replace(thickness=section.thickness * relative)
