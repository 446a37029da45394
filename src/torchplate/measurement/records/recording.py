"""Time records of a hammer test: the force, the responses, and the single hits cut out of them."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from torchplate.measurement.measurement import MeasurementError

Motion = Literal["displacement", "velocity", "acceleration"]
MIN_SAMPLES: Final = 16


@dataclass(frozen=True, eq=False)
class Recording:
    """One force channel and the responses to it, sampled together.

    Args:
        rate: Samples per second [Hz], > 0.
        force: [N], or the file's unit.
        response: [m, m/s or m/s²], or the file's unit; one row for each channel.
        reference: Label of the node that is hit, with its direction's sign; 0 where the file names none.
        responses: Labels of the response nodes, likewise.
        motion: What the responses are; None where the file does not say.
        has_unit: Whether the file states units.
        source: File and place in it.
        coordinates: Node label → place [m], where the file holds them.
        notes: What was assumed of it, each a sentence.
    """

    rate: float
    force: Float[np.ndarray, " n_sample"]
    response: Float[np.ndarray, "n_response n_sample"]
    reference: int = 0
    responses: tuple[int, ...] = ()
    motion: Motion | None = None
    has_unit: bool = False
    source: str = ""
    coordinates: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 < self.rate < float("inf"):
            raise MeasurementError(
                f"{self.source}: expected a sampling rate above 0 Hz, got {self.rate:g}. Give it by --rate."
            )
        if self.response.shape[1] != len(self.force) or len(self.force) < MIN_SAMPLES:
            raise MeasurementError(
                f"{self.source}: expected force and responses of the same length, {MIN_SAMPLES} samples or more, got "
                f"{len(self.force)} and {self.response.shape[1]}. Export all channels of a hit together."
            )
        if not (np.isfinite(self.force).all() and np.isfinite(self.response).all()):
            raise MeasurementError(f"{self.source}: expected finite samples, got NaN or infinity. Export it again.")


@dataclass(frozen=True)
class Cutting:
    """How single hits are cut out of a recording, and which of them are thrown away.

    Args:
        trigger: Part of the highest force at which a hit begins [-], 0 to 1.
        pre_trigger: Time before it that belongs to the record [s], ≥ 0.
        duration: Length of a record [s]; None for the time to the next hit, or the whole recording for a single one.
        double_hit: Second peak over the first above which a hit is thrown away [-]; None keeps all.
        overload: Samples in a row at the channel's extreme that say it was clipped; None keeps all.

    Raises:
        ValueError: A setting outside its range.
    """

    trigger: float = 0.1
    pre_trigger: float = 0.01
    duration: float | None = None
    double_hit: float | None = 0.1
    overload: int | None = 3

    def __post_init__(self) -> None:
        if not 0 < self.trigger < 1:
            raise ValueError(
                f"Expected a trigger between 0 and 1 of the highest force, got {self.trigger:g}. Take 0.1."
            )
        if not 0 <= self.pre_trigger < float("inf"):
            raise ValueError(f"Expected a pre-trigger of 0 s or more, got {self.pre_trigger:g}. Take 0.01.")
        if self.duration is not None and not self.duration > 0:
            raise ValueError(f"Expected a duration above 0 s, got {self.duration:g}. Leave it out, or give seconds.")


class Hits(NamedTuple):
    """Hits at one node, cut to one length.

    Attributes:
        rate: [Hz].
        force: [n_hit, n_sample].
        response: [n_hit, n_response, n_sample].
        rejected: Why hits were thrown away, one sentence each.
        recording: The first recording they are from: labels and units.
    """

    rate: float
    force: np.ndarray
    response: np.ndarray
    rejected: tuple[str, ...]
    recording: Recording


def cut(recordings: list[Recording], cutting: Cutting) -> Hits:
    """Cut the hits out of recordings of one reference and the same responses.

    A recording that was triggered when it was made holds one hit, which is found again at its place.

    Raises:
        MeasurementError: Rates or channels that differ, no hit, or none that was kept.
    """
    first = recordings[0]
    for other in recordings[1:]:
        if abs(other.rate - first.rate) > 1e-6 * first.rate or other.response.shape[0] != first.response.shape[0]:
            raise MeasurementError(
                f"{other.source}: expected {first.rate:g} Hz and {first.response.shape[0]} responses as in "
                f"{first.source}, got {other.rate:g} Hz and {other.response.shape[0]}. Convert tests of one kind at a "
                "time."
            )
    starts = [_starts(recording, cutting) for recording in recordings]
    length = _length(recordings, starts, cutting)
    forces, responses, rejected = [], [], []
    for recording, own in zip(recordings, starts, strict=True):
        for number, start in enumerate(own, start=1):
            if start + length > len(recording.force):
                rejected.append(f"{recording.source}, hit {number}: the record ends before the hit has")
                continue
            inside = slice(start, start + length)
            force, response = recording.force[inside], recording.response[:, inside]
            fault = _fault(recording, force, response, cutting)
            if fault:
                rejected.append(f"{recording.source}, hit {number}: {fault}")
                continue
            forces.append(force)
            responses.append(response)
    if not forces:
        raise MeasurementError(
            f"{first.source}: expected a hit that can be used, got none: {rejected[0]}. Measure again, or keep such "
            "hits by --keep-all."
        )
    return Hits(first.rate, np.stack(forces), np.stack(responses), tuple(rejected), first)


def _starts(recording: Recording, cutting: Cutting) -> list[int]:
    """First samples of the records, pre-trigger included."""
    force = _upright(recording.force)
    highest = float(force.max())
    if highest <= 0:
        raise MeasurementError(
            f"{recording.source}: expected a hit in the force channel, got a flat one. Name the force channel by "
            "--force."
        )
    above = np.flatnonzero(force > cutting.trigger * highest)
    # Peaks closer than a tenth of the recording, or than a record, are one hit and its bounces.
    n = len(force)
    apart = _samples(cutting.duration, recording) if cutting.duration is not None else max(n // 10, 1)
    begins = [int(above[0])]
    for index in above[1:].tolist():
        if index - begins[-1] >= apart:
            begins.append(index)
    lead = _samples(cutting.pre_trigger, recording)
    return [max(index - lead, 0) for index in begins]


def _samples(seconds: float, recording: Recording) -> int:
    """Of a duration; one that no record has counts as longer than this one."""
    return round(min(seconds * recording.rate, len(recording.force) + 1.0))


def _upright(force: np.ndarray) -> np.ndarray:
    """The force with its offset off and its pulse upward."""
    level = force - np.median(force)
    return -level if -level.min() > level.max() else level


def _length(recordings: list[Recording], starts: list[list[int]], cutting: Cutting) -> int:
    if cutting.duration is not None:
        return max(_samples(cutting.duration, recordings[0]), MIN_SAMPLES)
    gaps = [
        end - begin
        for recording, own in zip(recordings, starts, strict=True)
        for begin, end in zip(own, [*own[1:], len(recording.force)], strict=True)
    ]
    # The end of a long recording may follow its last hit too soon: that hit is then left out.
    between = [b - a for own in starts for a, b in pairwise(own)]
    enough = 0.5 * min(between or gaps)
    return max(min(gap for gap in (*between, *gaps) if gap >= enough), MIN_SAMPLES)


def _fault(recording: Recording, force: np.ndarray, response: np.ndarray, cutting: Cutting) -> str:
    if cutting.overload is not None:
        if _clipped(force, recording.force, cutting.overload):
            return "the force channel was overloaded"
        for row, whole in zip(response, recording.response, strict=True):
            if _clipped(row, whole, cutting.overload):
                return "a response channel was overloaded"
    if cutting.double_hit is not None and _second_peak(_upright(force)) > cutting.double_hit:
        return "the hammer hit twice"
    return ""


def _clipped(record: np.ndarray, whole: np.ndarray, least: int) -> bool:
    """Whether so many samples in a row stand at the channel's extreme."""
    highest = float(np.abs(whole).max())
    if highest == 0:
        return False
    for side in (record, -record):
        at = side >= highest * (1 - 1e-9)
        if at.sum() >= least:
            run = np.convolve(at.astype(int), np.ones(least, dtype=int), mode="valid")
            if bool((run >= least).any()):
                return True
    return False


def _second_peak(force: np.ndarray) -> float:
    """The highest force after the pulse over that of the pulse [-]."""
    peak = int(force.argmax())
    level = float(force[peak])
    if level <= 0:
        return 0.0
    below = np.flatnonzero(force[peak:] < 0.05 * level)
    if not below.size:
        return 0.0
    end = peak + int(below[0])
    before = np.flatnonzero(force[:peak] < 0.05 * level)
    # A first pulse that is lower than the second one stands before it.
    earlier = float(force[: int(before[-1]) + 1].max()) if before.size else 0.0
    return max(float(force[end:].max()), earlier) / level


def with_labels(recording: Recording, reference: int, responses: tuple[int, ...]) -> Recording:
    """The recording with other node labels."""
    return replace(recording, reference=reference, responses=responses)
