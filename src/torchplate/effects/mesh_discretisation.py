"""A mesh that is too coarse for the band: the model's own missing effect, mended by a finer one."""

import dataclasses
from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect
from torchplate.plate import Mesh


@dataclass(frozen=True)
class MeshDiscretisation(Effect):
    """Each element of the config's mesh is split in refine × refine: the error of ω falls as 1/refine².

    Node labels stay. It multiplies `mesh.refine`, and is the same as raising that.

    Args:
        refine: ≥ 2, or 1 where the rest is extrapolated.
        extrapolate: whether the error that is left is taken off too, by Richardson's extrapolation from a mesh twice as
            fine; the same as `mesh.extrapolate`.

    Raises:
        ValueError: if refine is below 2.
    """

    refine: int = 2
    extrapolate: bool = False

    parameters = {}
    check = Check(1, "raise mesh.refine")
    acts_on = frozenset({"discretisation"})
    shows = "The model's frequencies are off by a part that grows with frequency, and a finer mesh brings them nearer."
    source = "Strang and Fix, An Analysis of the Finite Element Method (1973), chapter 6"

    def __post_init__(self) -> None:
        if self.refine < (1 if self.extrapolate else 2):
            raise ValueError(
                f"Expected mesh_discretisation.refine to be at least 2, got {self.refine}. Raise it, or leave the "
                "effect out."
            )

    def discretise(self, mesh: Mesh) -> Mesh:
        """The finer mesh."""
        return dataclasses.replace(
            mesh, refine=mesh.refine * self.refine, extrapolate=mesh.extrapolate or self.extrapolate
        )
