"""What a lab can do, and every test that follows from it for one plate."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis import channels_of
from torchplate.measurement import Imperfections
from torchplate.model import PlateModel, Point
from torchplate.planning.proposal import KINDS, AddedMass, Hammer, NoWindow, Proposal, Sensor, Wires

# The powers of 1/g, g = 1.3247... with g³ = g + 1: places that spread evenly and lie on no line of symmetry.
# Source: Roberts, The unreasonable effectiveness of quasirandom sequences (2018), on Kronecker sequences in the plane.
STRIDE = (0.7548776662466927, 0.5698402909980532)


@dataclass(frozen=True)
class Lab:
    """What can be done there.

    Args:
        can: words of `proposal.KINDS`.
        masses: pieces that there are [kg]; left out, `shares` of the plate.
        shares: of the plate's mass [-]: enough to part frequencies from their drift, too little to make another plate.
        mass_std: of the scale, of a mass [-], and at least `scale` [kg]: glue counts.
        scale: what it shows [kg].
        n_place: places that are tried for a mass, a sensor or a hit [-].
        margin: of places to the edges, relative [-]: a piece has a size.
        moved: supports go this far towards the middle, as part of their way to it [-].
    """

    can: tuple[str, ...] = tuple(KINDS)
    masses: tuple[float, ...] = ()
    shares: tuple[float, ...] = (0.02, 0.06)
    mass_std: float = 0.002
    scale: float = 1e-4
    n_place: int = 6
    margin: float = 0.05
    moved: float = 0.45

    def __post_init__(self) -> None:
        """Refuse what nobody can do."""
        for word in self.can:
            if word not in KINDS:
                raise ValueError(f"Expected what the lab can do out of {', '.join(KINDS)}, got '{word}'. Name these.")
        if any(mass <= 0 for mass in self.masses):
            raise ValueError(f"Expected masses above 0 kg, got {min(self.masses):g}. Leave that one out.")

    def proposals(self, model: PlateModel, imperfections: Imperfections) -> tuple[Proposal, ...]:
        """Every test that it could make of a plate, the cheapest first.

        Args:
            model: the given one, with the measurement's channels.
            imperfections: of its tests.
        """
        ways = {
            "window": self._without_window,
            "sensor": self._sensors,
            "hammer": self._hits,
            "mass": lambda plate: self._masses(plate, imperfections.std("position_std")),
            "wires": self._wires,
        }
        found = [one for word in self.can for one in ways[word](model)]
        return tuple(sorted(found, key=lambda one: one.cost))

    @staticmethod
    def _without_window(model: PlateModel) -> Iterator[Proposal]:
        if model.kind != "transmissibility":
            yield NoWindow()

    def _sensors(self, model: PlateModel) -> Iterator[Proposal]:
        taken = channels_of(model).response
        yield from (Sensor(node) for node in self._nodes(model, taken))

    def _hits(self, model: PlateModel) -> Iterator[Proposal]:
        taken = channels_of(model).reference
        if model.kind != "transmissibility":
            yield from (Hammer(node) for node in self._nodes(model, taken))

    def _masses(self, model: PlateModel, off: float) -> Iterator[Proposal]:
        mesh = model.mesh
        whole = float(_plate_mass(model))
        masses = self.masses or tuple(_round(share * whole) for share in self.shares)
        stds = off / mesh.length_x, off / mesh.length_y
        label = "added_mass"
        while label in model.effects:
            label += "_next"
        for mass in masses:
            for node in self._nodes(model):
                x, y = mesh.places([node])[0].tolist()
                yield AddedMass(node, (x, y), mass, max(self.scale, self.mass_std * mass), stds, label)

    def _wires(self, model: PlateModel) -> Iterator[Proposal]:
        for label, effect in model.effects.items():
            if effect.name != "support_spring":
                continue
            nodes, at = effect.nodes, effect.at  # type: ignore[attr-defined]
            before: tuple[Point, ...] = (*nodes, *(tuple(one) for one in at))
            places = model.mesh.places(list(before))
            seen = {before}
            for axis in (0, 1):
                moved = places.clone()
                # One more than the other, so that what was symmetric is not again.
                part = self.moved * torch.linspace(0.7, 1.0, len(moved)).to(moved)
                moved[:, axis] += part * (0.5 - moved[:, axis])
                after = tuple(map(tuple, moved.tolist())) if at else _nearest(model, moved)
                if after not in seen and len(set(after)) == len(after):
                    seen.add(after)
                    yield Wires(label, before, after)

    def _nodes(self, model: PlateModel, taken: Sequence[Point] = ()) -> list[int]:
        """Labels of nodes that spread over the plate, off its symmetries, and are not taken."""
        steps = torch.arange(1, 8 * self.n_place + 1, dtype=torch.float64)[:, None]
        places = self.margin + (1 - 2 * self.margin) * ((0.5 + steps * torch.tensor(STRIDE)) % 1.0)
        nodes = [node for node in dict.fromkeys(_nearest(model, places)) if node not in taken and _whole(model, node)]
        away = [node for node in nodes if not _symmetric(model, node)]
        return (away or nodes)[: self.n_place]


def _nearest(model: PlateModel, places: Float[Tensor, "n 2"]) -> tuple[int, ...]:
    """Labels of the nodes of the test sheet nearest to some places."""
    mesh = model.mesh
    column, row = ((places[:, axis] * n).round().int() for axis, n in ((0, mesh.n_x), (1, mesh.n_y)))
    return tuple((row * (mesh.n_x + 1) + column + 1).tolist())


def _whole(model: PlateModel, node: int) -> bool:
    """Whether there is plate at a node."""
    try:
        model.mesh.check_on_plate([node])
    except ValueError:
        return False
    return True


def _symmetric(model: PlateModel, node: int) -> bool:
    """Whether a node lies on a line through the middle of the plate, or on a diagonal."""
    mesh = model.mesh
    x, y = (mesh.places([node])[0] - 0.5).tolist()
    near = 0.25 / max(mesh.n_x, mesh.n_y)
    return min(abs(x), abs(y)) < near or abs(abs(x) - abs(y)) < near


def _plate_mass(model: PlateModel) -> Tensor:
    """At the middle of the box [kg]."""
    plan = model.plan(model.space.to_si(model.known.new_full((len(model.names),), 0.5)))
    area = plan.geometry.length_x * plan.geometry.length_y
    return (plan.section.areal_mass.mean() * area).mean()


def _round(mass: float) -> float:
    """To a figure that a person would choose: 1, 2 or 5 times a power of ten [kg]."""
    power = 10.0 ** torch.tensor(mass, dtype=torch.float64).log10().floor().item()
    steps: Sequence[float] = (1.0, 2.0, 5.0, 10.0)
    return float(f"{min(steps, key=lambda step: abs(step * power / mass - 1)) * power:.3g}")
