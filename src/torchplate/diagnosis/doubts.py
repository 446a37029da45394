"""Which hypotheses a diagnosis leaves open, from everything that was fitted."""

from collections.abc import Sequence

import torch

from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.rivals import Doubt, Rival
from torchplate.diagnosis.selection.criterion import Choice, weight_of
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.settings import SETTINGS


def doubts_of(final: State) -> tuple[Doubt, ...]:
    """One for each named effect, the others as they are beside it; of the model itself where nothing is named."""
    if not final.named:
        weight = weight_of([final.fit]).likelihood
        return (_doubt("", [_rival(final.fit, weight)], final.fit, weight),)
    return tuple(_of_choice(one.known) for one in final.named)


def _of_choice(known: Choice) -> Doubt:
    weight = weight_of([one.fit for one, _ in known.every]).likelihood
    rivals = [
        _rival(one.fit, weight, one.name, one.label, probability)
        for one, probability in known.every
        if one is known.best or probability > SETTINGS.comparison.faint * known.confidence
    ]
    return _doubt(known.best.label, sorted(rivals, key=lambda one: -one.probability), known.best.fit, weight)


def _doubt(label: str, rivals: Sequence[Rival], best: Fit, weight: float) -> Doubt:
    return Doubt(label, tuple(rivals), weight, best.judged.noise_scale, best.by_noise, best.gap)


def _rival(fit: Fit, weight: float, name: str = "", label: str = "", probability: float = 1.0) -> Rival:
    model = fit.model
    precision = weight * fit.information + torch.diag(torch.where(fit.told > 0, fit.told, UNIFORM))
    found = fit.judged.found if fit.judged.found is not None else fit.about
    # The plate stays from test to test; what each channel has of its own does not.
    found = None if found is None else found._replace(channels=None)
    return Rival(
        name,
        label,
        probability,
        model.effects,
        model.known_values,
        model.searched,
        model.space.to_cube(fit.theta),
        0.5 * (precision + precision.mT),
        found,
    )
