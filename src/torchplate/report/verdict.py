"""The verdict of a diagnosis in one sentence."""

from torchplate.diagnosis import Diagnosis, Named
from torchplate.notation import percent
from torchplate.report.blocks.numbers import listed


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence: what was found, and what it means for the use of the values."""
    gap, missing = diagnosis.gap, diagnosis.effects
    before, after, floor = percent(gap.baseline), percent(gap.final), percent(gap.noise_floor)
    names = listed([_named(effect) for effect in missing])
    were, them = ("was", "it") if len(missing) == 1 else ("were", "them")
    if diagnosis.verdict == "consistent":
        added = f" with {names} added" if missing else " as it is"
        return (
            f"Consistent: the model{added} explains the measurement down to its noise (gap {after}, noise alone "
            f"{floor}), and nothing else of the catalogue is missing; the fitted values can be used."
        )
    if diagnosis.verdict == "explained":
        return (
            f"Explained: {names} {were} missing; with {them} the gap falls from {before} to {after}, where noise alone "
            f"makes {floor}, so the values of the new model can be used."
        )
    if diagnosis.verdict == "partly_explained":
        return (
            f"Partly explained: {names} {were} missing, and with {them} the gap falls from {before} to {after}, but "
            f"noise alone makes {floor}: something without a name is still missing, and the fitted values may make up "
            "for it."
        )
    return (
        f"Unexplained: something is missing that no effect of the catalogue accounts for; the gap stays at {after}, "
        f"where noise alone makes {floor}, so do not take the fitted values for those of the plate."
    )


def _named(effect: Named) -> str:
    twins = listed([f"`{name}`" for name in effect.equivalent], "or")
    return f"`{effect.name}`" + (f" (or {twins}, which these data cannot tell from it)" if twins else "")
