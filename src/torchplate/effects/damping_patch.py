"""A patch that dissipates more than the rest: a damping layer, tape, a cable glued on."""

from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, patch_aspect, unit_interval
from torchplate.plate import Mesh, Section, patched


@dataclass(frozen=True)
class DampingPatch(Effect):
    """Bending stiffness times 1 + iη under a rectangular patch; what its edges cut of elements is integrated.

    The patch is a square of side size · √(Lx Ly) in metres, or a rectangle, as in `stiffness_loss`. What the edges cut
    is a little stiffer, too: across the cut the compliances 1 / (1 + iη) and 1 add; see `patched`. A mode's loss factor
    grows by η times the part of its strain energy that lies in the patch.
    """

    parameters = {
        "x": Parameter("-", "centre along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y": Parameter("-", "centre along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "size": Parameter("-", "root of its area over √(Lx·Ly)", unit_interval, prior=Prior(0.05, 0.5)),
        "loss_factor": Parameter(
            "-",
            "loss factor there beyond the plate's",
            nonnegative,
            neutral=0.0,
            prior=Prior(1e-3, 1.0, logarithmic=True),
        ),
        "aspect": patch_aspect,
    }
    check = Check(4, "put a second sensor near the suspected place, and take the local decay")
    acts_on = frozenset({"damping", "section"})
    shows = "Rounds the peaks of modes that bend in the patch and no others; frequencies stay."
    source = "Ungar and Kerwin, Loss factors of viscoelastic systems in terms of energy concepts, JASA 34 (1962) 954"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The loss factors of each element, on top of what it has."""
        lossy = torch.complex(torch.ones_like(value["loss_factor"]), value["loss_factor"])
        return patched(section, mesh, lossy, value["x"], value["y"], value["size"], value["aspect"])
