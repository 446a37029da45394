"""What a lab can do with a plate that it has tested once: each a test that could come next, and what it asks."""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from torchplate.effects import Effect, PointMass
from torchplate.model import PlateModel, Point

# What a sensor that is mounted anew at another place leaves behind.
OF_THE_MOUNTING = frozenset({"sensor_position"})
# What names channels by their labels does nothing to others.
OF_CHANNELS = frozenset({"channel_polarity", "channel_swap"})


@dataclass(frozen=True)
class Proposal(ABC):
    """A test that could come next; the state that it puts the plate in, and the channels that are read then.

    `can` is the word by which a user allows it. `cost` orders by what it asks of a lab: 1 a setting of the analyser, 2
    a sensor or a hammer at another place, 3 something that has to be weighed and stuck on, 4 to hang the plate anew.
    """

    can: ClassVar[str]
    cost: ClassVar[int]

    @property
    @abstractmethod
    def title(self) -> str:
        """What is done, in a few words."""

    @property
    @abstractmethod
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""

    @property
    def response(self) -> tuple[Point, ...] | None:
        """Where sensors sit that were not there; None where they stay."""
        return None

    @property
    def reference(self) -> tuple[Point, ...] | None:
        """Where the plate is hit that was not hit there; None where these points stay."""
        return None

    @property
    def places(self) -> tuple[Point, ...]:
        """Where something is attached that was not there."""
        return ()

    @property
    def off(self) -> tuple["Proposal", ...]:
        """The same with each thing that is not known exactly off by one standard deviation."""
        return ()

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """The effects of a model of the plate in this state."""
        return dict(model.effects)

    def known(self) -> Mapping[str, float]:
        """Numbers that belong to the state."""
        return {}

    def state(self, model: PlateModel) -> PlateModel:
        """A model of the plate in this state, with the channels that are read in it.

        Args:
            model: of the plate as it was tested, in a basis that knows the places.
        """
        effects = self.effects(model)
        known = {key: value for key, value in model.known_values.items() if key.rpartition(".")[0] in effects}
        searched = {key: ends for key, ends in model.searched.items() if key.rpartition(".")[0] in effects}
        found = model.replaced(effects=effects, known=known | dict(self.known()), searched=searched)
        found.response = self.response or model.response
        found.reference = self.reference or model.reference
        return found

    def body(self, effects: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:  # noqa: ARG002  # some read it
        """What the state says in a config, beside its name and its file.

        Args:
            effects: of the config.
        """
        found: dict[str, Any] = {}
        if self.response is not None:
            found["response"] = [_plain(point) for point in self.response]
        if self.reference is not None:
            found["reference"] = [_plain(point) for point in self.reference]
        return found


@dataclass(frozen=True)
class NoWindow(Proposal):
    """The same test without an exponential window."""

    can = "window"
    cost = 1

    @property
    def title(self) -> str:
        """What is done, in a few words."""
        return "no exponential window"

    @property
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""
        return (
            "Take the exponential window off the analyser and repeat the test. Record for so long that the plate has "
            "come to rest: what is cut off looks like damping."
        )

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """Without the window, if there was one."""
        return {label: one for label, one in model.effects.items() if one.name != "exponential_window"}

    def body(self, effects: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """A window of rate 0 says that there is none."""
        label = next((key for key, one in effects.items() if one["effect"] == "exponential_window"), "window")
        return {"effects": {label: {"effect": "exponential_window", "rate": 0.0}}}


@dataclass(frozen=True)
class Sensor(Proposal):
    """A response more, at a node of the test sheet."""

    node: int

    can = "sensor"
    cost = 2

    @property
    def title(self) -> str:
        """What is done, in a few words."""
        return f"sensor at node {self.node}"

    @property
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""
        return f"Mount the sensor at node {self.node} and hit the same points as before."

    @property
    def response(self) -> tuple[Point, ...]:
        """The new one alone: what the others read is known."""
        return (self.node,)

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """Without what came from the place of another sensor."""
        gone = OF_THE_MOUNTING | OF_CHANNELS
        return {label: one for label, one in model.effects.items() if one.name not in gone}


@dataclass(frozen=True)
class Hammer(Proposal):
    """A reference more, at a node of the test sheet."""

    node: int

    can = "hammer"
    cost = 2

    @property
    def title(self) -> str:
        """What is done, in a few words."""
        return f"hit node {self.node}"

    @property
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""
        return f"Hit node {self.node} too, with the sensors where they were."

    @property
    def reference(self) -> tuple[Point, ...]:
        """The new one alone."""
        return (self.node,)

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """Without what was wrong with channels that are not read now."""
        return {label: one for label, one in model.effects.items() if one.name not in OF_CHANNELS}


@dataclass(frozen=True)
class AddedMass(Proposal):
    """A weight of known mass, stuck on at a known place.

    Args:
        node: of the test sheet.
        place: of this node, relative [-].
        mass: [kg].
        mass_std: of the scale [kg].
        place_std: of the place along each side, relative [-].
        label: of it in the model.
    """

    node: int
    place: tuple[float, float]
    mass: float
    mass_std: float = 1e-4
    place_std: tuple[float, float] = (0.0, 0.0)
    label: str = "added_mass"

    can = "mass"
    cost = 3

    @property
    def title(self) -> str:
        """What is done, in a few words."""
        return f"mass of {1e3 * self.mass:.4g} g at node {self.node}"

    @property
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""
        return (
            f"Weigh a compact piece of about {1e3 * self.mass:.4g} g, stick it on firmly with its middle at node "
            f"{self.node} (x = {self.place[0]:.4g}, y = {self.place[1]:.4g} of the sides), and repeat the test as it "
            "was. Write what it weighs, glue and all, in place of the mass below."
        )

    @property
    def places(self) -> tuple[Point, ...]:
        """Where it sits."""
        return (self.place,)

    @property
    def off(self) -> tuple[Proposal, ...]:
        """By its weight, and along both sides; inwards, where it sits on an edge."""
        found = [dataclasses.replace(self, mass=self.mass + self.mass_std)] if self.mass_std > 0 else []
        for axis, std in enumerate(self.place_std):
            if std > 0:
                moved = list(self.place)
                moved[axis] += std if moved[axis] + std <= 1 else -std
                found.append(dataclasses.replace(self, place=(moved[0], moved[1])))
        return tuple(found)

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """With it."""
        return {**model.effects, self.label: PointMass()}

    def known(self) -> Mapping[str, float]:
        """Where it sits, and what it weighs."""
        x, y = self.place
        return {f"{self.label}.x": x, f"{self.label}.y": y, f"{self.label}.mass": self.mass}

    def body(self, effects: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:  # noqa: ARG002  # as of all
        """The mass as an effect of this state."""
        x, y = (round(part, 6) for part in self.place)
        mass = {"value": self.mass, "std": self.mass_std}
        return {"effects": {self.label: {"effect": "point_mass", "x": x, "y": y, "mass": mass}}}


@dataclass(frozen=True)
class Wires(Proposal):
    """The plate hung up, or set down, at other points.

    Args:
        label: of the supports in the model.
        before: nodes, or relative places, in their order.
        after: where each of them is now.
    """

    label: str
    before: tuple[Point, ...]
    after: tuple[Point, ...]

    can = "wires"
    cost = 4

    @property
    def title(self) -> str:
        """What is done, in a few words."""
        return f"{self.label} at {', '.join(_word(point) for point in self.after)}"

    @property
    def instruction(self) -> str:
        """The same for the lab, whole sentences."""
        moved = ", ".join(f"{_word(a)} to {_word(b)}" for a, b in zip(self.before, self.after, strict=True))
        return (
            f"Move the supports '{self.label}', each with its own spring: {moved}. Leave sensors and hammer points "
            "where they were and repeat the test."
        )

    @property
    def places(self) -> tuple[Point, ...]:
        """Where the supports are now."""
        return self.after

    def effects(self, model: PlateModel) -> dict[str, Effect]:
        """The supports elsewhere, with whatever changes one of them."""
        there = dict(zip(map(_key, self.before), self.after, strict=True))

        def moved(effect: Effect) -> Effect:
            changes = {}
            for option in ("nodes", "at"):
                points: Sequence[Any] = getattr(effect, option, ())
                if points and all(_key(point) in there for point in points):
                    changes[option] = tuple(there[_key(point)] for point in points)
            return dataclasses.replace(effect, **changes) if changes else effect

        own = {label for label, one in model.effects.items() if label == self.label or one.name == "support_asymmetry"}
        return {label: moved(one) if label in own else one for label, one in model.effects.items()}

    def body(self, effects: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The supports in place of those that the config has."""
        key = "nodes" if isinstance(self.after[0], int) else "at"
        return {"effects": {self.label: dict(effects[self.label]) | {key: [_plain(point) for point in self.after]}}}


KINDS: dict[str, type[Proposal]] = {kind.can: kind for kind in (NoWindow, Sensor, Hammer, AddedMass, Wires)}


def _key(point: Any) -> Any:
    return point if isinstance(point, int) else tuple(point)


def _plain(point: Any) -> Any:
    return point if isinstance(point, int) else [round(float(part), 6) for part in point]


def _word(point: Any) -> str:
    return f"node {point}" if isinstance(point, int) else "({:.3g}, {:.3g})".format(*point)
