"""A loss that depends on the direction in which the plate bends: wood, composites, printed plates."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Mesh, Section


@dataclass(frozen=True)
class DirectionalDamping(Effect):
    """E_x (1 + iη_x), E_y (1 + iη_y), G (1 + iη_xy), beyond the loss factor that all have in common.

    D₁₁ loses η_x, D₂₂ η_y and D₃₃ η_xy. D₁₂ loses (η_x + η_y) / 2, to first order what √(E_x E_y) loses: so a strip
    that bends along x with its sides free loses η_x and nothing else. A mode's loss factor is the mean of the three,
    weighed by the energy that it stores in each.

    Where one loss, with the common one, is beyond 40 times the other (ν = 0.3), D₁₂ loses less: see `Section.passive`.
    """

    parameters = {
        f"loss_{axis}": Parameter(
            "-", f"loss factor of {modulus} beyond the common one", nonnegative, neutral=0.0, prior=Prior(0.0, 0.05)
        )
        for axis, modulus in (("x", "E_x"), ("y", "E_y"), ("xy", "G_xy"))
    }
    check = Check(4, "record decays of strips cut along each side, and of a mode that twists")
    acts_on = frozenset({"damping", "section"})
    # The same in all directions, it is a loss factor of the whole plate.
    contains = ("hysteretic_damping",)
    like = frozenset({"damping_scatter"})
    shows = "Modes that bend along x, along y and those that twist are rounded by different fractions; levels stay."
    source = (
        "McIntyre and Woodhouse, On measuring the elastic and damping constants of orthotropic sheet materials, 1988"
    )

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The loss factors of D₁₁, D₂₂, D₁₂ and D₃₃, on top of what each element has."""
        x, y, xy = torch.broadcast_tensors(*(value[name] for name in self.parameters))
        return section.lossier(torch.stack([x, y, 0.5 * (x + y), xy], dim=-1)[..., None, :])
