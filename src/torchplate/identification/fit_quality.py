"""How good a fit is, in words that its gap earns: that a search has settled says nothing of it."""

from torchplate.notation import percent

NOTHING, POOR, PARTIAL = 1.0, 0.5, 0.1
"""Gaps of FRFs: ‖measured − model‖ / ‖measured‖, whose square is the part of the FRFs' energy that is left.

FRFs that are zero everywhere have a gap of 1. At 0.5 a quarter of the energy is left, at 0.1 a hundredth.
"""
POOR_FREQUENCY, PARTIAL_FREQUENCY = 0.05, 0.01
"""Errors of natural frequencies, relative to them: 5 % is 10 % of stiffness or mass, 1 % what a table without standard
deviations is taken to be known to."""

LOOK_FIRST = (
    "Do not use the values: look at sides, units, channels, supports and the mesh (torchplate inspect), then "
    "torchplate diagnose."
)
MEND_FIRST = "Do not use the values: first mend what is said of the FRFs, and run again."
SOMETHING_MISSING = "Look for what is missing (torchplate diagnose) before the values are used."


def fit_in_words(gap: float, of_frfs: bool, misread: bool = False) -> str:
    """What a gap says of the fit, and what to do.

    Args:
        gap: of FRFs, or the error of natural frequencies [-].
        of_frfs: which.
        misread: whether a sign, phases or a factor of the FRFs look wrong, which is said before.
    """
    told = percent(gap)
    look, missing = (MEND_FIRST, MEND_FIRST) if misread else (LOOK_FIRST, SOMETHING_MISSING)
    if not of_frfs:
        if not gap < POOR_FREQUENCY:
            return f"The fit is poor: the natural frequencies are off by {told}. {LOOK_FIRST}"
        if not gap < PARTIAL_FREQUENCY:
            return f"The fit is partial: the natural frequencies are off by {told}. {SOMETHING_MISSING}"
        return f"The fit is close: the natural frequencies are within {told}."
    if not gap < NOTHING:
        model = "As the FRFs stand, the model" if misread else "The model"
        return f"{model} explains nothing: its gap is {told}, and FRFs that are zero everywhere have 100 %. {look}"
    left = f"{percent(gap**2, 2)} of the FRFs' energy"
    if not gap < POOR:
        return f"The fit is poor: a gap of {told} leaves {left} unexplained. {look}"
    if not gap < PARTIAL:
        return f"The fit is partial: a gap of {told} leaves {left} unexplained. {missing}"
    return f"The fit is close: a gap of {told} leaves {left} unexplained."
