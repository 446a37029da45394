"""Which names count as right.

An answer is the name with its `equivalent` set. It is right for a hidden effect if it holds the true name and every
other member is one that these data may not be able to tell from it: a physical twin in the table below, whose condition
holds. `mesh_discretisation` is never held against an answer: the config's mesh has an error of its own.

E, k, c and β (where the config has one) are searched, so effects count as twins up to those. The classes hold what is
exact or nearly so in principle; that a case is noisy makes nothing a twin. `Judge` is where a rule from the data would
go in: see `score.verdict`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

MESH = "mesh_discretisation"
# Given the record of a case and the other name: whether the data, too, cannot tell the two. None: the table alone.
Judge = Callable[[dict[str, Any], str], bool]


@dataclass(frozen=True)
class Twins:
    """Two effects that may pass for each other, and why."""

    one: str
    other: str
    why: str
    # Numbers that part the two where the config gives them with a std.
    parted_by: tuple[str, ...] = ()


TABLE = (
    Twins("density", "thickness", "K ∝ E h³, M ∝ ρh: with E free both scale M alone.", ("density", "thickness")),
    Twins("density", "sensor_gain", "With E and all springs free a scaled M is a scaled FRF.", ("density",)),
    Twins("thickness", "sensor_gain", "As density: with E free h scales M alone, and so every FRF.", ("thickness",)),
    Twins("orthotropy", "aspect_ratio", "With g = 1 a ratio r is the aspect ratio r^(-1/4).", ("length_x", "length_y")),
    Twins("orthotropy", "poisson_ratio", "ν moves D66 against D11 as the shear factor does; D12 parts them weakly."),
    Twins("viscous_damping", "exponential_window", "(s + σ)² = s² + 2σs + ...: a window is a mass coefficient of 2σ."),
    Twins("viscous_damping", "hysteretic_damping", "sbK is iβK over a narrow band, saM likewise iηM."),
    Twins("support_spring", "ground_spring", "A further wire is a spring to the ground at its place, with a dashpot."),
    Twins("support_spring", "ground_dashpot", "A further wire is a dashpot at its place if its spring is too soft."),
    Twins("support_asymmetry", "ground_spring", "A tighter wire is that wire and a spring to the ground beside it."),
    Twins("channel_swap", "channel_polarity", "Channels at places of mirror symmetry differ in sign alone."),
    Twins("frequency_dependent_loss", "viscous_damping", "β fⁿ is β and sb over a band; its modulus parts them."),
    Twins("frequency_dependent_loss", "hysteretic_damping", "A falling loss is that of M over a narrow band."),
    Twins("roving_mass", "point_mass", "For a single response it is a mass at that response."),
    Twins("stiffness_loss", "thickness_taper", "A large weak patch at one side leans as a taper does."),
)  # fmt: skip


def twins(name: str, case: dict[str, Any]) -> dict[str, str]:
    """The names that may stand beside a true one, each with its reason.

    Args:
        name: what is hidden.
        case: the record of the case (`Case.record`).
    """
    hidden = {one["effect"]: one["parameters"] for one in case["hidden"]}
    found: dict[str, str] = {}
    for pair in TABLE:
        if name not in (pair.one, pair.other) or set(pair.parted_by) & set(case["known"]):
            continue
        other = pair.other if name == pair.one else pair.one
        if _holds(name, other, hidden[name], case):
            found[other] = pair.why
    return found


def _holds(name: str, other: str, p: dict[str, float], case: dict[str, Any]) -> bool:
    """The conditions that depend on what is hidden."""
    if {name, other} == {"orthotropy", "aspect_ratio"}:
        # A shear factor away from 1 moves the twist modes, which no aspect ratio does.
        return name == "aspect_ratio" or abs(p["shear_factor"] - 1) < 0.03
    if {name, other} == {"viscous_damping", "exponential_window"}:
        return name == "exponential_window" or p["stiffness_coefficient"] == 0
    if {name, other} == {"support_asymmetry", "ground_spring"}:
        # One wire, and tighter: a spring is never negative.
        changed = [value for value in p.values() if value != 1.0] if name == "support_asymmetry" else []
        return len(changed) == 1 and changed[0] > 1
    if {name, other} == {"roving_mass", "point_mass"}:
        return name == "roving_mass" and len(case["response"]) == 1
    if {name, other} == {"channel_swap", "channel_polarity"}:
        return name == "channel_swap" and case["n_frf"] <= 12
    if {name, other} == {"stiffness_loss", "thickness_taper"}:
        return name == "stiffness_loss" and p["size"] > 0.3 and p["factor"] > 0.7
    return True


def right(name: str, answer: dict[str, Any], case: dict[str, Any], judge: Judge | None = None) -> bool:
    """Whether one entry of a diagnosis names a hidden effect, with no stranger in its set."""
    members = {answer["name"], *answer.get("equivalent", [])}
    strangers = members - {name, MESH} - set(twins(name, case))
    if judge is not None:
        strangers = {other for other in strangers if not judge(case, other)}
    return name in members and not strangers


def sure_of_twin(name: str, answer: dict[str, Any], case: dict[str, Any]) -> bool:
    """Whether an entry is a twin of the truth, named as if it were sure: wrong, and worth counting."""
    return answer["name"] in twins(name, case) and name not in answer.get("equivalent", [])
