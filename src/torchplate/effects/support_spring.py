"""Springs and dashpots to the ground: the wires a free plate hangs on."""

from collections.abc import Sequence
from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Point, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import Local, Mesh


class SupportTerms(Local):
    """Local terms of supports: what an effect that changes supports knows them by."""


@dataclass(frozen=True)
class SupportSpring(Effect):
    """One spring and one dashpot to the ground at each node, all alike: f = −k w − c dw/dt.

    Args:
        nodes: node labels; or
        at: relative places [x, y], each 0 to 1.

    Raises:
        ValueError: if both or neither of nodes and at are given, or a node is named twice.
    """

    nodes: Sequence[int] = ()
    at: Sequence[Sequence[float]] = ()

    parameters = {
        "stiffness": Parameter(
            "N/m",
            "spring stiffness at each node",
            nonnegative,
            prior=Prior(0.03, 1e3, logarithmic=True, relative_to="plate"),
        ),
        "viscous_damping": Parameter(
            "N s/m",
            "dashpot at each node",
            nonnegative,
            neutral=0.0,
            prior=Prior(1e-4, 10.0, logarithmic=True, relative_to="plate"),
        ),
    }
    check = Check(2, "look for a further support at the place found, and test without it")
    acts_on = frozenset({"stiffness", "damping"})
    shows = "Lifts the rigid-body modes off zero and damps them; hardly moves the bending modes."
    source = "seed paper, after Eq. 18"

    def __post_init__(self) -> None:
        if bool(self.nodes) == bool(self.at):
            raise ValueError(
                "Expected support_spring to have either `nodes` (labels) or `at` (relative places), "
                f"got {'both' if self.nodes else 'neither'}. Give one of them."
            )
        if twice := sorted({node for node in self.nodes if list(self.nodes).count(node) > 1}):
            raise ValueError(
                f"Expected each node once, got {', '.join(map(str, twice))} more than once. Correct the labels; a "
                "second spring at a node is a further support_spring."
            )

    @property
    def points(self) -> list[Point]:
        """Where they are: labels or relative places."""
        return [*self.nodes, *self.at]

    def local(self, mesh: Mesh, value: Value) -> SupportTerms:
        """One term for each supported node."""
        vector = mesh.deflection_at(mesh.places(self.points).to(value["stiffness"]))
        stiffness, viscous = (
            value[name][..., None].expand(*value[name].shape, len(vector)) for name in self.parameters
        )
        return SupportTerms(vector, stiffness=stiffness, viscous=viscous)
