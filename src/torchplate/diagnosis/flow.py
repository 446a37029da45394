"""The steps of a diagnosis: from a model and a measurement to what is missing."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import torch

from torchplate.diagnosis.field import force_alone, with_field
from torchplate.diagnosis.field.one_force import OneForce
from torchplate.diagnosis.holdout import held_out
from torchplate.diagnosis.one_thread import one_thread
from torchplate.diagnosis.result import Diagnosis
from torchplate.diagnosis.selection.criterion import is_explained
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.trace import Trace
from torchplate.diagnosis.summary import summarise
from torchplate.diagnosis.table import diagnose_table
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Imperfections, Measurement, NaturalFrequencies, noise_level
from torchplate.model import PlateModel


@one_thread()
@torch.no_grad()
def diagnose(
    model: PlateModel,
    measurement: Measurement | None = None,
    natural_frequencies: NaturalFrequencies | None = None,
    *,
    tolerance: Mapping[str, float] | None = None,
    n_average: int | None = None,
    gain_is_unknown: bool = False,
    imperfections: Imperfections | None = None,
    most_effects: int = 3,
    seed: int = 0,
    say: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find where a model and a measurement disagree, name what is missing, add it, and show the gap shrink.

    Torch and SciPy's BLAS have one thread meanwhile: more are slower, and digits would hang on how many there are.

    Args:
        model: the model as it is believed; its searched parameters are fitted, its numbers are not. All is done on the
            CPU, wherever it is.
        measurement: FRFs; the model's responses and references are theirs.
        natural_frequencies: a table instead of FRFs.
        tolerance: how well numbers are known: "label.parameter", "mesh.length_x" → standard deviation in SI units.
        n_average: records behind each FRF, where known.
        gain_is_unknown: the level of the FRFs carries no unit.
        imperfections: what the test is not perfect in; what is not told has the size of a careful test.
        most_effects: that may be added.
        seed: of the choice of held-out FRFs.
        say: is told what is being tried.

    Raises:
        ValueError: if there is neither a measurement nor a table, or both.
    """
    if (measurement is None) == (natural_frequencies is None):
        raise ValueError("Expected either FRFs or natural frequencies, got both or neither. Give one of them.")
    if measurement is None:
        assert natural_frequencies is not None
        return diagnose_table(model.on("cpu"), natural_frequencies.to("cpu"), tolerance=tolerance, say=say)
    began, model, measurement = time.monotonic(), model.on("cpu"), measurement.to("cpu")
    noise = noise_level(measurement, n_average)
    target = FrfTarget(
        measurement, noise, held_out(measurement.measured, seed), gain_is_unknown, imperfections or Imperfections()
    )
    selection = ForwardSelection.of(model, target, dict(tolerance or {}), say)
    noise = selection.builder.target.noise
    baseline = selection.baseline()
    if (own := selection.on_the_given_mesh(baseline)) is not None:
        selection, state = own
        seen = Trace(selection.builder, noise, state.fit, state, state, (), selection.prior)
        return summarise(seen, time.monotonic() - began)
    selection, baseline = selection.robust_baseline(baseline)
    state, rankings = selection.add_effects(baseline, most_effects)
    few = len(measurement.pairs) < target.settings.holding_out.few
    if few and state.fit.reduced_misfit > target.settings.selecting.far_off:
        selection, baseline = selection.inflated(selection.begun)
        state, rankings = selection.add_effects(baseline, most_effects)
    given, unrefined = selection.as_given(state)
    seen = Trace(selection.builder, noise, given, selection.begun, state, tuple(rankings), selection.prior, unrefined)
    found = summarise(seen, time.monotonic() - began)
    if found.verdict in ("consistent", "explained") or is_explained(state.fit, selection.builder.target):
        return found
    # Beside nothing, since what was named may stand in for it.
    without = selection.begun if state.named else state
    force = force_alone(selection.builder, without.fit, selection.prior, say)
    if force is not None and (attached := _attached(selection, seen, force)) is not None:
        return summarise(attached, time.monotonic() - began)
    if force is not None and state.named:
        say("  nothing of what was named is needed beside it")
        state = selection.begun
        found = summarise(replace(seen, final=state, unrefined=None), time.monotonic() - began)
    if force is None and state.named:
        force = force_alone(selection.builder, state.fit, selection.prior, say)
    return with_field(found, selection.builder, state.fit, selection.prior, say, force)


def _attached(selection: ForwardSelection, seen: Trace, force: OneForce) -> Trace | None:
    """What was seen, with what the catalogue has for a force at one place in place of all names; None where nothing.

    Args:
        selection: that named something else, or nothing.
        seen: what it has fitted.
        force: that accounts for everything.
    """
    if force.law is None:
        return None
    found = selection.attached(seen.rankings, force.theta, force.place, force.law)
    if found is None:
        return None
    state, ranked = found
    given, unrefined = selection.as_given(state)
    return replace(seen, given=given, final=state, rankings=(ranked,), unrefined=unrefined)
