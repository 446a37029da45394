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
        case "point_mass":
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
        gap = sum((found.get(key, 1.0) - value) ** 2 for key, value in true.items())
        return sqrt(gap / sum((value - 1) ** 2 for value in true.values()))
    try:
        real, named = size(effect, true), size(effect, found)
    except KeyError:
        return None
    return None if real is None or named is None or real == 0 else abs(named - real) / abs(real)


def numbers(answer: dict[str, Any]) -> Numbers:
    """The parameters of one entry of a diagnosis as plain numbers."""
    return {name: float(entry["value"]) for name, entry in answer.get("parameters", {}).items()}
