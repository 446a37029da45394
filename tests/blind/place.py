"""How near the numbers of a right name are: place, size, and Young's modulus."""

from math import hypot, log, sqrt
from typing import Any

Numbers = dict[str, float]


def place_error(true: Numbers, found: Numbers, sides: tuple[float, float]) -> float | None:
    """Distance between two relative places, over √(Lx Ly) [-]; None where the effect has no place."""
    if not {"x", "y"} <= true.keys() & found.keys():
        return None
    distance = hypot((true["x"] - found["x"]) * sides[0], (true["y"] - found["y"]) * sides[1])
    return distance / sqrt(sides[0] * sides[1])


def size(effect: str, p: Numbers) -> float | None:
    """The one number that says how much there is of an effect; 0 is nothing. None where it has none."""
    match effect:
        case "stiffness_loss":
            return (1 - p["factor"]) * p["size"] ** 2
        case "damping_patch":
            return p["loss_factor"] * p["size"] ** 2
        case "aspect_ratio":
            return p["ratio"] - 1
        case "orthotropy":
            return hypot(log(p["young_ratio"]), log(p["shear_factor"]))
        case "sensor_gain":
            return p["gain"] - 1
        case "thickness_taper":
            return hypot(p["slope_x"], p["slope_y"])
        case "sensor_position":
            return hypot(p["dx"], p["dy"])
        case "frequency_dependent_loss":
            return p["exponent"]
        case "directional_damping":
            return hypot(p["loss_x"], p["loss_y"], p["loss_xy"])
        case "air_loading":
            return p["density"]
        case "point_mass" | "roving_mass":
            return p["mass"]
        case "ground_spring" | "support_spring" | "edge_spring":
            return p["stiffness"]
        case "ground_dashpot":
            return p["viscous_damping"]
        case "exponential_window":
            return p["rate"]
        case "time_delay":
            return p["delay"]
        case "viscous_damping":
            # Loss factor at 100 Hz, where the two coefficients meet.
            return p.get("mass_coefficient", 0.0) / 628.3 + p.get("stiffness_coefficient", 0.0) * 628.3
        case "hysteretic_damping":
            return p.get("stiffness_loss_factor", 0.0) + p.get("mass_loss_factor", 0.0) / 628.3**2
    return None


def size_error(effect: str, true: Numbers, found: Numbers, stated: Numbers | None = None) -> float | None:
    """|found − true| / |true| of the size [-].

    Args:
        effect: the name, the same in both.
        true: hidden parameters.
        found: named parameters.
        stated: of a density, thickness or Poisson's ratio: what the config says, the size being the difference.
    """
    if effect in ("density", "thickness", "poisson_ratio"):
        if stated is None or effect not in stated or "value" not in found:
            return None
        return abs(found["value"] - true["value"]) / abs(true["value"] - stated[effect])
    if effect == "support_asymmetry":
        # A factor that is not among those found is 1: the common spring is searched, and takes what all share.
        got = [found.get(key, 1.0) for key in true]
        common = sum(true.values()) / sum(got) if len(found.keys() & true.keys()) < len(true) else 1.0
        gap = sum((common * one - value) ** 2 for one, value in zip(got, true.values(), strict=True))
        return sqrt(gap / sum((value - 1) ** 2 for value in true.values()))
    try:
        real, named = size(effect, true), size(effect, found)
    except KeyError:
        return None
    return None if real is None or named is None or real == 0 else abs(named - real) / abs(real)


# The option of an effect that says where or which.
WHICH = {
    "edge_spring": "edge",
    "sensor_position": "response",
    "channel_polarity": "channels",
    "channel_swap": "channels",
    "support_spring": "nodes",
}


def which_is_right(effect: str, true: dict[str, Any], found: dict[str, Any], case: dict[str, Any]) -> bool | None:
    """Whether the right edge, sensor, channels or nodes are named; None where there is nothing to name.

    Args:
        effect: the name.
        true: hidden options.
        found: the entry of model.yaml.
        case: the record of the case: its grid, responses and references.
    """
    option = WHICH.get(effect)
    if option is None or option not in true or "response" not in case:
        return None
    if option == "channels":
        pairs = [[_pairs(channel, case) for channel in options.get(option, [])] for options in (true, found)]
        if effect == "channel_polarity":
            return frozenset().union(*pairs[0]) == frozenset().union(*pairs[1])
        return frozenset(pairs[0]) == frozenset(pairs[1])
    if option == "nodes":
        named = found.get("nodes", found.get("at", []))
        return set(true[option]) == {_node(point, case["grid"]) for point in named}
    named = found.get(option)
    if option == "response" and named is None:
        return len(case["response"]) == 1
    return bool(true[option] == _node(named, case["grid"]))


def _node(point: Any, grid: tuple[int, int]) -> Any:
    """The label of a relative place; anything else stays."""
    if isinstance(point, list | tuple) and len(point) == 2:
        return round(point[1] * grid[1]) * (grid[0] + 1) + round(point[0] * grid[0]) + 1
    return point


def _pairs(channel: Any, case: dict[str, Any]) -> frozenset[tuple[int, int]]:
    """The FRFs (response, reference) that a channel names."""
    ends = case["response"], case["reference"]
    if isinstance(channel, int):
        channel = [channel, None] if channel in ends[0] else [None, channel]
    response, reference = (
        own if named is None else [_node(named, case["grid"])] for named, own in zip(channel, ends, strict=True)
    )
    return frozenset((j, k) for j in response for k in reference)


def numbers(answer: dict[str, Any]) -> Numbers:
    """The parameters of one entry of a diagnosis as plain numbers."""
    return {name: float(entry["value"]) for name, entry in answer.get("parameters", {}).items()}
