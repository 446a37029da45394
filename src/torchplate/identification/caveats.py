"""What must be known before the values of an identification are trusted."""

from torch import Tensor

from torchplate.discrepancy import Objective, Sensitivity
from torchplate.identification.fit_quality import NOTHING, PARTIAL
from torchplate.measurement import assumed
from torchplate.model import PlateModel
from torchplate.notation import percent

# A standard error above this part of the interval says that the data hardly narrow it.
WIDE = 0.5
# A MAC below this says that two shapes are not of one mode.
UNLIKE = 0.7
# Of a gap that mirrored phases leave: a quarter of its energy. Damping of the right sign leaves none that they take.
MIRRORED = 0.5


def caveats(objective: Objective, theta: Tensor, seen: Sensitivity) -> list[str]:
    """What must be known before the values are trusted, a sentence each: bounds, blind and flat directions."""
    space = objective.model.space
    sentences = []
    for index, name in enumerate(space.names):
        value, unit = f"{float(theta[index]):.6g}", "" if space.units[index] == "-" else f" {space.units[index]}"
        low, high = float(space.low[index]), float(space.high[index])
        if bool(seen.blind[index]):
            sentences.append(
                f"The data cannot see {name}: no prediction changes over its whole interval, so its value "
                f"{value} means nothing. Give it as a number, or measure something that depends on it."
            )
            continue
        if bool(space.at_bound(theta)[index]):
            end = "upper" if float(theta[index]) > 0.5 * (low + high) else "lower"
            sentences.append(
                f"{name} ended on the {end} bound of its interval, {value}{unit}: the optimum lies beyond it, or an "
                "effect is missing that this parameter stands in for. Widen the interval, or look for the effect."
            )
        if not bool(seen.flat[:, index].any()) and float(seen.std[index]) > WIDE * (high - low):
            sentences.append(
                f"The data hardly see {name}: its standard error, {float(seen.std[index]):.3g}{unit}, is as wide "
                "as its interval. Measure where it acts, or give it as a number."
            )
    for direction in seen.flat:
        together = [
            name for name, part in zip(space.names, direction, strict=True) if abs(part) > 0.1 * direction.abs().max()
        ]
        sentences.append(
            f"The data see {' and '.join(together)} only together: moving them along one direction changes no "
            "prediction. Give one of them as a number."
        )
    of_one_model = isinstance(objective.model, PlateModel)
    if (table := objective.evidence.natural_frequencies) is not None and (said := assumed(table)):
        sentences.append(said)
    if (modal := objective.evidence.modal_model) is not None and modal.assumed:
        sentences.append(modal.assumed)
    if (
        modal is not None
        and of_one_model
        and (unlike := [pair for pair in modal.pairs(objective.model, theta) if pair.mac < UNLIKE])
    ):
        told = ", ".join(f"{pair.measured:.5g} Hz (MAC {pair.mac:.2f} with mode {pair.mode})" for pair in unlike)
        sentences.append(
            f"The model has no shape like those measured at {told}: look at the places of the points, and at what is "
            "missing in the model."
        )
    return sentences


def of_sign(objective: Objective, theta: Tensor) -> list[str]:
    """What is to be known where all FRFs have the other sign, or mirrored phases, if they have."""
    if objective.evidence.measurement is None:
        return []
    gap = float(objective.gap(theta))
    if gap < PARTIAL:
        return []
    turned, mirrored = float(objective.turned_gap(theta)), float(objective.mirrored_gap(theta))
    if mirrored < MIRRORED * min(gap, turned):
        return [
            f"With the phases of all FRFs mirrored the gap is {percent(mirrored)} instead of {percent(gap)}: they are "
            "of exp(−iωt) where exp(+iωt) is expected. Write the complex conjugate of each."
        ]
    if gap < NOTHING:
        return []
    # A model that moves next to nothing has a gap of 100 % with either sign.
    if not turned < NOTHING or percent(turned) == percent(NOTHING):
        return []
    return [
        f"With the sign of all FRFs turned the gap is {percent(turned)} instead of {percent(gap)}: a sensor is mounted "
        "upside down, or a direction is -Z where the file says +Z. Add the effect channel_polarity with channels: "
        "[[null, null]], or turn the sign in the export."
    ]
