"""What may have changed between two tests: an effect that came in, or one parameter that has another value."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import torch

from torchplate.diagnosis.candidates.candidate import Candidate, nameable
from torchplate.diagnosis.candidates.held_edges import PREFIX
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.tolerance import SIDES
from torchplate.model import PlateModel, Searched
from torchplate.plate import Plan


@dataclass(frozen=True)
class Change:
    """One change of a plate.

    Attributes:
        name: of the effect that came in, or "label.parameter".
        label: of the effect in the model.
        candidate: the effect; None where a parameter has another value.
        interval: of that parameter.
        before: what it was.
        n_option: choices of fixed options that the effect has here.
    """

    name: str
    label: str
    candidate: Candidate | None = None
    interval: Searched | None = None
    before: float | None = None
    n_option: int = 1

    @property
    def key(self) -> tuple[str, str]:
        """Name and label; of effects with options, these too."""
        options = "" if self.candidate is None else str(sorted(self.candidate.options.items()))
        return self.name, f"{self.label} {options}"

    def applied(self, model: PlateModel) -> PlateModel:
        """The model with it; its parameters are searched."""
        if self.candidate is not None:
            return with_candidate(model, self.label, self.candidate)
        assert self.interval is not None
        known = {key: value for key, value in model.known_values.items() if key != self.name}
        return model.replaced(known=known, searched=model.searched | {self.name: self.interval})

    def is_of_the_section(self, model: PlateModel) -> bool:
        """Whether the plate itself is another one where it bends: what a mesh leaves of it is another error then.

        A plate that is stiffer, thicker or heavier everywhere lacks on a mesh what it did, in proportion.

        Args:
            model: without it.
        """
        effect = model.effects[self.label] if self.candidate is None else self.candidate.effect
        return "section" in effect.acts_on and effect.moves_natural_frequencies() and effect.name != "plate"

    def frees(self, names: Sequence[str]) -> list[str]:
        """Parameters that the reference says nothing of any more."""
        if self.candidate is None:
            return [name for name in names if name == self.name]
        return [name for name in names if name.startswith(f"{self.label}.")]


def allowed(everyone: Sequence[Candidate], given: PlateModel) -> list[Candidate]:
    """Effects that may have come in.

    Args:
        everyone: the candidates.
        given: as the config has it: what it searches is a parameter that may have another value.
    """
    there = {effect.name for effect in given.effects.values()}
    # An effect of the whole plate that is there already has a parameter that changes.
    return [one for one in everyone if one.name not in there or one.has_place or one.options]


def parameters_that_moved(
    model: PlateModel, own: Collection[str], values: Mapping[str, float], numbers: Collection[str] = ()
) -> list[Change]:
    """Each parameter of the config with another value: within its interval, or that in which it would be looked for.

    Args:
        model: the given one.
        own: parameters that have a value of their own in this test anyhow.
        values: of the reference test.
        numbers: that are searched only because they are not known exactly.
    """
    middle = {name: 0.5 * (one.low + one.high) for name, one in model.searched.items()}
    plan = model.plan(torch.tensor([values.get(name, middle[name]) for name in model.names]).to(model.known))
    found = []
    for name, value in values.items():
        label, _, key = name.rpartition(".")
        if name in own or label.startswith(PREFIX) or label not in (model.effects.keys() - {SIDES}):
            continue
        searched = None if name in numbers else model.searched.get(name)
        interval = searched or _interval(model, label, key, value, plan)
        if interval is not None:
            found.append(Change(name, label, interval=interval, before=value))
    return found


def _interval(model: PlateModel, label: str, key: str, value: float, plan: Plan) -> Searched | None:
    """Where a number that is known may have gone; None where the catalogue has an effect for that, or no prior."""
    effect = model.effects[label]
    parameter = effect.parameters[key]
    # A place and an outline do not move, and what is wrong with the plate's own numbers are effects.
    still = parameter.detail or key in ("x", "y", "x0", "y0", "x1", "y1")
    if parameter.prior is None or effect.name == "plate" or still:
        return None
    ends = parameter.prior_interval(plan.section, plan.geometry)
    low, high = min(ends.low, value), max(ends.high, value)
    straight = parameter.prior.logarithmic and low > 0
    return Searched(low, high, straight) if high > low else None


def n_names(changes: Sequence[Change]) -> int:
    """Names among which the prior probability of a change is shared."""
    return len(nameable()) + len({one.name for one in changes if one.candidate is None})


def grid(change: Change, n: int) -> list[dict[str, float]]:
    """Values of one parameter, from end to end of its interval."""
    assert change.interval is not None
    low, high, logarithmic = change.interval.low, change.interval.high, change.interval.logarithmic
    parts = torch.linspace(0.0, 1.0, n, dtype=torch.float64).tolist()
    if logarithmic:
        return [{change.name: low * (high / low) ** part} for part in parts]
    return [{change.name: low + part * (high - low)} for part in parts]
