"""The cheapest measurement that would part effects which these data cannot tell apart."""

from collections.abc import Iterable, Sequence

# Effect → (cost, what to do). What costs least is asked first; one sentence parts an effect from all others that do not
# share it.
CHECKS: dict[str, tuple[int, str]] = {
    "density": (1, "weigh the plate: a scale good to 0.5 % settles the density"),
    "thickness": (2, "measure the thickness with a calliper at several points, to 0.01 mm"),
    "thickness_taper": (2, "measure the thickness with a calliper near all four corners"),
    "aspect_ratio": (1, "measure both sides with a ruler, to 0.5 mm"),
    "sensor_gain": (3, "calibrate the chain: hit a freely hung block of known mass, where a/F must be 1/m"),
    "sensor_position": (1, "measure with a ruler where the sensor sits"),
    "channel_polarity": (2, "tap beside each sensor and look at the sign of the first half wave"),
    "channel_swap": (2, "tap beside each sensor and see which channel answers"),
    "time_delay": (3, "send one signal to both channels of the analyser and read the phase between them"),
    "exponential_window": (1, "look up the window in the analyser's set-up, or record once without it"),
    "viscous_damping": (3, "record free decays of a low and a high mode: the decay rates part the laws of damping"),
    "hysteretic_damping": (3, "record free decays of a low and a high mode: the decay rates part the laws of damping"),
    "damping_patch": (4, "put a second sensor near the suspected place, and take the local decay"),
    "orthotropy": (4, "test a strip cut along each side, or twist the plate statically: E_x, E_y and G part there"),
    "poisson_ratio": (5, "measure a torsion mode and a bending mode of a strip of the same sheet"),
    "point_mass": (1, "look for what is mounted at the place found, and weigh it"),
    "ground_spring": (2, "look for what touches the plate at the place found, and test without it"),
    "ground_dashpot": (2, "look for what touches the plate at the place found, and test without it"),
    "support_asymmetry": (3, "load each support with a known weight and measure how far it gives"),
    "support_spring": (2, "look for a further support at the place found, and test without it"),
    "edge_spring": (2, "free the edge, or clamp it tighter, and test again"),
    "stiffness_loss": (3, "look at the place found (dye, tap test), and add a sensor off the symmetry line near it"),
    "mesh_discretisation": (1, "raise mesh.refine"),
}


def next_measurements(sets: Iterable[Sequence[str]], unexplained: bool, few: bool, symmetric: bool) -> list[str]:
    """What to measure next, the cheapest first.

    Args:
        sets: the effects named, each with those that are equivalent to it; a set of one needs nothing.
        unexplained: whether something is left without a name.
        few: whether there are fewer than three FRFs.
        symmetric: whether all sensors or all forces lie on a line of symmetry.
    """
    wanted: dict[str, int] = {}
    for names in sets:
        if len(names) < 2:
            continue
        ranked = sorted(CHECKS[name] for name in names if name in CHECKS)
        # One effect fewer than there are has to be settled.
        for cost, sentence in ranked[: max(1, len(names) - 1)]:
            others = ", ".join(name for name in names)
            wanted[f"{sentence} (parts {others})"] = cost
    if unexplained:
        if few:
            wanted["measure more FRFs, at least three: one cannot say where a fault sits"] = 2
        wanted["hit twice as hard and compare: what changes is not linear"] = 2
        wanted["hang the plate otherwise and test again: what changes belongs to the supports"] = 3
        wanted["add sensors where the residual force is largest"] = 4
    if symmetric:
        wanted["add a sensor off the symmetry lines: mirror images of a place look alike from them"] = 3
    return [sentence for sentence, _ in sorted(wanted.items(), key=lambda item: item[1])]
