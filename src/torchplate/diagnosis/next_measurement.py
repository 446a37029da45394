"""The cheapest measurement that would part effects which these data cannot tell apart."""

from collections.abc import Iterable, Sequence

from torchplate.effects import CATALOGUE


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
        known = [CATALOGUE[name].check for name in names if name in CATALOGUE]
        ranked = sorted(check for check in known if check is not None)
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
