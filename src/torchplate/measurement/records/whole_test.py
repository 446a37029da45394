"""The recordings of a whole hammer test as one measurement."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from torchplate.measurement.level import KIND_OF_MOTION
from torchplate.measurement.measurement import SI_UNIT, Channel, Measurement, MeasurementError
from torchplate.measurement.records.estimate import Estimate, Estimated, Windows, estimate
from torchplate.measurement.records.recording import Cutting, Hits, Recording, cut
from torchplate.notation import percent

ALIAS_FREE: Final = 2.56
"""Samples per hertz that analysers take; above rate / 2.56 the anti-alias filter is at work."""

RINGING, NOISY = 0.03, 0.1
"""Root mean square of a response in the last twentieth of its record, over that of the whole record [-]: from here on
FRFs leak, the second where its noise is not known. Of a plate with a loss of a hundredth, whose upper modes have died
by then, the lowest mode is at 13 % of its beginning where all together are at 0.04."""
ENDED: Final = 7.0
"""Time constants of the window that is proposed in a record: it ends at a thousandth. At four, a fiftieth, what is cut
off is still more than the noise of a quiet test, and was taken for another window."""


KEPT = 0.5
"""Of a pulse's peak [-], which a force window that is meant for it keeps whole."""


def frf_of_hits(
    recordings: Sequence[Recording],
    cutting: Cutting | None = None,
    windows: Windows | None = None,
    estimator: Estimate = "H1",
) -> Measurement:
    """Average the hits at each node, and put the FRFs of all nodes together.

    Args:
        recordings: Those with one `reference` are averaged.
        cutting: How hits are cut out and which are thrown away.
        windows: Over each hit.
        estimator: "H1", "H2" or "Hv".

    Raises:
        MeasurementError: Recordings that do not fit together, or hold no hit that can be used.
    """
    cutting = cutting or Cutting()
    groups: dict[int, list[Recording]] = defaultdict(list)
    for recording in recordings:
        groups[recording.reference].append(recording)
    if cutting.duration is None:
        # One length for all nodes, or their lines would differ.
        cutting = _common(list(groups.values()), cutting)
    hits = {reference: cut(own, cutting) for reference, own in sorted(groups.items())}
    responses = sorted({node for own in hits.values() for node in own.recording.responses})
    references = list(hits)
    first = next(iter(hits.values()))
    for own in hits.values():
        _check_windows(own, windows)
    found = {reference: estimate(own, windows, estimator) for reference, own in hits.items()}
    lines = next(iter(found.values())).frequency
    for reference, one in found.items():
        if len(one.frequency) != len(lines) or float(np.abs(one.frequency - lines).max()) > 1e-6 * lines[-1]:
            raise MeasurementError(
                f"{hits[reference].recording.source}: expected the lines of {first.recording.source}, got others. Give "
                "one --duration, and records of one sampling rate."
            )
    keep = lines <= first.rate / ALIAS_FREE * (1 + 1e-9)
    return _measurement(hits, found, lines[keep], keep, responses, references, windows)


def _check_windows(hits: Hits, windows: Windows | None) -> None:
    """Whether windows leave something of the hits.

    Raises:
        MeasurementError: A force window that ends before the pulse, or a time constant within a sample.
    """
    source = hits.recording.source
    if windows is not None and windows.exponential is not None and windows.exponential * hits.rate < 1:
        raise MeasurementError(
            f"{source}: expected a time constant of more than one sample, {1 / hits.rate:.3g} s, got "
            f"{windows.exponential:g} s, which leaves nothing. --exponential-window is in s."
        )
    if windows is None or windows.force is None:
        return
    force = np.abs(hits.force - np.median(hits.force, axis=1, keepdims=True))
    window, _ = Windows(windows.force).over(force.shape[1], hits.rate)
    if bool(((force * window).max(axis=1) < KEPT * force.max(axis=1)).any()):
        latest = float(force.argmax(axis=1).max()) / hits.rate
        raise MeasurementError(
            f"{source}: expected a force window that holds the pulse, which comes {latest:.3g} s after the record "
            f"starts, as the window does, got one of {windows.force:g} s. Give --force-window "
            f"{latest + windows.force:.2g}."
        )


def _common(groups: Sequence[list[Recording]], cutting: Cutting) -> Cutting:
    lengths = [cut(own, replace(cutting, double_hit=None, overload=None)).force.shape[1] for own in groups]
    rate = groups[0][0].rate
    return replace(cutting, duration=min(lengths) / rate)


def _measurement(
    hits: dict[int, Hits],
    found: dict[int, Estimated],
    lines: np.ndarray,
    keep: np.ndarray,
    responses: Sequence[int],
    references: Sequence[int],
    windows: Windows | None,
) -> Measurement:
    shape = (len(lines), len(responses), len(references))
    frf = np.zeros(shape, dtype=np.complex128)
    coherence = np.full(shape, np.nan)
    measured = np.zeros(shape[1:], dtype=bool)
    notes = list(dict.fromkeys(note for own in hits.values() for note in own.recording.notes))
    places = {}
    motions = {own.recording.motion or "acceleration" for own in hits.values()}
    if len(motions) > 1:
        named = " and ".join(sorted(motions))
        raise MeasurementError(
            f"{hits[references[0]].recording.source}: expected one kind of response, got {named}. Convert them apart."
        )
    for k, reference in enumerate(references):
        own = hits[reference]
        places.update(dict(own.recording.coordinates))
        notes += [f"Left out {text}." for text in own.rejected]
        for column, node in enumerate(own.recording.responses):
            j = responses.index(node)
            frf[:, j, k] = found[reference].frf[keep, column]
            measured[j, k] = True
            # Of a single hit it is 1 by definition, and would be believed.
            if len(own.force) > 1:
                coherence[:, j, k] = found[reference].coherence[keep, column]
    if windows is not None and windows.exponential is not None:
        notes.append(
            f"Windowed by exp(-t/{windows.exponential:g} s): `torchplate new` writes {{effect: exponential_window, "
            f"rate: {1 / windows.exponential:.6g}}} into the config, which takes it off."
        )
    notes += _ringing(hits, windows)
    kind = KIND_OF_MOTION[motions.pop()]
    return Measurement(
        frequency=torch.from_numpy(lines),
        frf=torch.from_numpy(frf),
        measured=torch.from_numpy(measured),
        response=tuple(Channel(node, "w", places.get(node)) for node in responses),
        reference=tuple(Channel(node, "w", places.get(node)) for node in references),
        kind=kind,
        unit=SI_UNIT[kind],
        coherence=torch.from_numpy(coherence) if bool(np.isfinite(coherence).any()) else None,
        source=hits[references[0]].recording.source,
        notes=tuple(notes),
        window=0.0 if windows is None or windows.exponential is None else 1 / windows.exponential,
    )


def _ringing(hits: dict[int, Hits], windows: Windows | None) -> list[str]:
    """What is to be said of responses that are cut off while they ring."""
    left = {reference: _left_at_end(own, windows) for reference, own in hits.items()}
    worst = max(left, key=lambda reference: left[reference])
    own = hits[worst]
    if left[worst] <= (RINGING if _n_before(own) else NOISY):
        return []
    window = own.force.shape[1] / own.rate / ENDED
    return [
        f"The responses still ring where their records end, after a hit at {worst} at {percent(left[worst], 2)} of "
        "their mean level: the FRFs leak, and their peaks are too low and too broad. Record longer, or give "
        f"--exponential-window {window:.2g}."
    ]


def _left_at_end(hits: Hits, windows: Windows | None) -> float:
    """Level of the responses in the last twentieth of their records over that of the whole [-], noise taken off."""
    n = hits.force.shape[1]
    n_last, n_before = max(n // 20, 1), _n_before(hits)
    # A channel that does not stand at zero before the hit, as a sound card's, does not ring for that.
    level = hits.response[..., :n_before].mean(-1, keepdims=True) if n_before else 0.0
    square = np.square(hits.response - level)
    noise = square[..., :n_before].mean(-1) if n_before else np.zeros(square.shape[:-1])
    if windows is not None and windows.exponential is not None:
        square = square * np.exp(-2 * np.arange(n) / hits.rate / windows.exponential)
    last, whole = (np.maximum(part.mean(-1) - noise, 0.0).sum() for part in (square[..., -n_last:], square))
    return float(np.sqrt(last / whole)) if whole > 0 else 0.0


def _n_before(hits: Hits) -> int:
    """Samples before each hit, which are noise; 0 where they are too few to say so."""
    force = np.abs(hits.force - np.median(hits.force, axis=1, keepdims=True))
    n_before = int((force > 0.05 * force.max(axis=1, keepdims=True)).argmax(axis=1).min()) * 3 // 4
    return n_before if n_before >= 8 else 0
