"""Supports that are not all alike: one wire is tighter, shorter or slacker than the others."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Point, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.effects.support_spring import SupportTerms
from torchplate.plate import Local, Mesh

FACTOR = Parameter(
    "-",
    "spring of that node over the common one; one factor for each node",
    nonnegative,
    neutral=1.0,
    prior=Prior(0.0, 2.0),
)
# Rows of shape functions are of order one; those of one place agree to rounding.
SAME = 1e-9


@dataclass(frozen=True)
class SupportAsymmetry(Effect):
    """Springs k factor_1, k factor_2, ... in place of k at nodes that a `support_spring` of the model supports.

    The factors count as the nodes are listed, which may be all that are supported or some. All of them together with a
    searched k are one too many: keep k, or one of them.

    Args:
        nodes: labels of supported nodes; or
        at: relative places [x, y] of supports.

    Raises:
        ValueError: if neither nodes nor at are given, or later if no support is there.
    """

    nodes: Sequence[int] = ()
    at: Sequence[Sequence[float]] = ()

    parameters = {"factor_1": FACTOR}
    check = Check(3, "load each support with a known weight and measure how far it gives")
    acts_on = frozenset({"stiffness"})
    shows = "Parts and turns the rigid-body modes on the supports; hardly moves the bending modes."
    source = "Ewins, Modal Testing (2000), on the support of the test structure; statics of a rigid body on springs"
    stage = 3

    def __post_init__(self) -> None:
        if bool(self.nodes) == bool(self.at):
            raise ValueError(
                "Expected support_asymmetry to have either `nodes` (labels) or `at` (relative places) of the supports, "
                f"got {'both' if self.nodes else 'neither'}. Give them as the support_spring has them."
            )
        names = [f"factor_{index + 1}" for index in range(len(self.nodes) + len(self.at))]
        object.__setattr__(self, "parameters", dict.fromkeys(names, FACTOR))

    def attached(self, mesh: Mesh, terms: Sequence[Local], value: Value) -> Sequence[Local]:
        """The supports' springs, each times its factor; all else stays."""
        points: list[Point] = [*self.nodes, *self.at]
        factor = torch.stack(torch.broadcast_tensors(*(value[name] for name in self.parameters)), dim=-1)
        missing = torch.ones(len(points), dtype=torch.bool)
        changed: list[Local] = []
        for term in terms:
            if isinstance(term, SupportTerms) and term.stiffness is not None:
                rows = mesh.deflection_at(mesh.places(points).to(term.vector))
                same = (term.vector[:, None] - rows).abs().amax(-1) < SAME
                missing &= ~same.any(0).cpu()
                scale = 1 + ((factor - 1)[..., None, :] * same).sum(-1)
                term = term._replace(stiffness=term.stiffness * scale)
            changed.append(term)
        if bool(missing.any()):
            where = [point for point, gone in zip(points, missing.tolist(), strict=True) if gone]
            raise ValueError(
                f"Expected a support_spring at each place of support_asymmetry, got none at {where}. "
                "Name the nodes of the model's supports."
            )
        return changed
