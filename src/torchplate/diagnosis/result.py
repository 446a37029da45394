"""What a diagnosis ends with: every number and sentence of it, and nothing that computes.

The report, `diagnosis.json`, TensorBoard and `torchplate.diagnose` all read this one object.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.rivals import Doubt
from torchplate.measurement import Measurement
from torchplate.model import PlateModel

Verdict = Literal["consistent", "explained", "partly_explained", "unexplained"]
SCHEMA = "torchplate.diagnosis/1"
METRIC = "relative_frf_norm"


@dataclass(frozen=True)
class Estimate:
    """A number that was found.

    Attributes:
        value: in SI units.
        std: standard error from the noise; None where these data do not see it.
        unit: SI unit, "-" for none.
        low: lower end of the 90 % interval of the same posterior; None where these data do not see it.
        high: upper end.
    """

    value: float
    std: float | None
    unit: str
    low: float | None = None
    high: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return dict(vars(self))


@dataclass(frozen=True)
class Named:
    """An effect that was found missing and added.

    Attributes:
        name: of the effect in the catalogue.
        label: in the model.
        options: its fixed options (nodes, an edge, channels).
        equivalent: names of the effects that these data cannot tell from it.
        confidence: probability that the name, or one of its equivalents, is right.
        parameters: what was found for each of its parameters.
        evidence: one sentence: where it shows, and why the others do not explain it.
        gap_before: of the fitted FRFs without it and those after it.
        gap_after: with it, all fitted together; that of the last one is the final gap.
    """

    name: str
    label: str
    options: Mapping[str, Any]
    equivalent: tuple[str, ...]
    confidence: float
    parameters: Mapping[str, Estimate]
    evidence: str
    gap_before: float
    gap_after: float

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {
            "name": self.name,
            "label": self.label,
            "options": dict(self.options),
            "equivalent": list(self.equivalent),
            "confidence": self.confidence,
            "parameters": {name: found.to_dict() for name, found in self.parameters.items()},
            "evidence": self.evidence,
            "gap_before": self.gap_before,
            "gap_after": self.gap_after,
        }


@dataclass(frozen=True)
class Gap:
    """How far model and measurement are apart: mean over FRFs of ‖measured − model‖ / ‖measured‖.

    Attributes:
        baseline: the given model after its own fit, on the FRFs that the fit saw.
        final: the last model, likewise.
        heldout_baseline: on the FRFs that no fit saw; None where there is a single FRF.
        heldout_final: likewise.
        noise_floor: what the noise alone makes it, from the measurement alone.
        expected: what noise and the imperfections of the test, as large as was said, together make it beside the last
            model; None where that was not asked.
    """

    baseline: float
    final: float
    heldout_baseline: float | None
    heldout_final: float | None
    noise_floor: float
    expected: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {"metric": METRIC, **vars(self)}


@dataclass(frozen=True)
class Step:
    """The gap after one step of the selection: the baseline, an effect added, an effect removed.

    Attributes:
        label: "baseline", or what was done: "+ point_mass", "- sensor_gain".
        gap: on the fitted FRFs, of all that is in the model by then, fitted together.
        heldout: on the others.
        misfit: mean square of the residuals over their noise; 1 where nothing but noise is left.
    """

    label: str
    gap: float
    heldout: float | None
    misfit: float


@dataclass(frozen=True)
class Band:
    """A stretch of frequency in which the misfit sits.

    Attributes:
        low: [Hz].
        high: [Hz].
        share: of the whole squared misfit [-].
    """

    low: float
    high: float
    share: float


@dataclass(frozen=True)
class ChannelGap:
    """The gap of one FRF.

    Attributes:
        response: label of the response ("3w").
        reference: label of the reference.
        before: at the baseline.
        after: at the end.
        floor: what noise alone makes it.
        heldout: whether no fit saw it.
    """

    response: str
    reference: str
    before: float
    after: float
    floor: float
    heldout: bool


@dataclass(frozen=True)
class ForceMap:
    """Where on the plate a residual force would have to act: an index over a grid of places.

    Attributes:
        x: places along x, relative [-].
        y: along y, relative [-].
        index: part of the misfit that one force at each place, free at every line, would explain [n_y, n_x] [-].
    """

    x: Float[Tensor, " n_x"]
    y: Float[Tensor, " n_y"]
    index: Float[Tensor, "n_y n_x"]


@dataclass(frozen=True)
class Location:
    """Where model and measurement disagree: in frequency, over the channels, over the plate, and in kind.

    Attributes:
        bands: where most of the misfit sits, the worst first.
        channels: the gap of every FRF, the worst first.
        kind: how much of the misfit a residual force in proportion to ω⁰ (stiffness), iω (damping) and ω² (mass) at the
            best place explains, and what a common or a single channel's factor explains ("sensor chain") [-].
        map: of the residual force; None where it says nothing (a single FRF).
        sentences: the same in words.
    """

    bands: tuple[Band, ...]
    channels: tuple[ChannelGap, ...]
    kind: Mapping[str, float]
    map: ForceMap | None
    sentences: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {
            "bands_hz": [[band.low, band.high] for band in self.bands],
            "channels": [
                {"response": one.response, "reference": one.reference, "gap": one.before} for one in self.channels
            ],
            # A product of matrices may differ in its last digit from one place in memory to another.
            "kind": {name: float(f"{part:.12g}") for name, part in self.kind.items()},
        }


FIRST_REFIT: Final = (
    "Gap at first refit: what the model with this effect leaves, fitted as far as it takes to rank the effects. What "
    "the named ones leave together, fitted to their end, stands above."
)
"""Of `Scored.gap`, where people read it."""


@dataclass(frozen=True)
class Scored:
    """One line of the score table: an effect at its best place, before any refit.

    Attributes:
        name: of the effect.
        options: its fixed options.
        expected_drop: part of the squared misfit that it would take away, the fitted parameters projected out [-].
        expected_change: parameter → the value it would take.
        twins: names of effects whose signature is parallel to this one's.
        gap: after a first refit; None where none was made. See `FIRST_REFIT`.
        remark: what became of it: "named", "equivalent", "rejected: ...".
    """

    name: str
    options: Mapping[str, Any]
    expected_drop: float
    expected_change: Mapping[str, float]
    twins: tuple[str, ...] = ()
    gap: float | None = None
    remark: str = ""


@dataclass(frozen=True)
class Overlay:
    """What was measured and what the models say, for figures.

    Attributes:
        measured: FRFs, with their channels and lines.
        noise: standard deviation of each.
        before: of the fitted baseline.
        after: of the last model.
        heldout: which FRFs no fit saw.
    """

    measured: Measurement
    noise: Float[Tensor, "n_frequency n_response n_reference"]
    before: Complex[Tensor, "n_frequency n_response n_reference"]
    after: Complex[Tensor, "n_frequency n_response n_reference"]
    heldout: Bool[Tensor, "n_response n_reference"]


ONE_FORCE: Final = "one force"
"""The form of a force at one place, of whatever law."""


@dataclass(frozen=True)
class FoundField:
    """What is missing as a field over the plate, or a force at one place: its kind and place, and no name.

    Attributes:
        kind: "stiffness", "mass", "loss" or "support" (a force from outside, in proportion to the deflection).
        place: where its weight sits, relative.
        spread: standard deviation of the weight about that along x and y, relative; of one force that of its place.
        others: places that these data cannot tell from it: its mirror images.
        total: of a mass [kg], of springs [N/m]; of stiffness and loss the mean over the plate [-]; of one force its
            root mean square over that of the hits [N/N].
        unit: of the total.
        n_x: nodes of the grid along x.
        n_y: along y.
        values: at the nodes, along x first; one direction after another where it has several. Of one force the part of
            the misfit that it would explain there.
        form: of the prior: "rough", "smooth" or "sparse"; "one force" of a force at one place.
        strength: standard deviation of a value beforehand, as cross-validation chose it, in the values' unit.
        probability: of each kind, as far as these data tell.
        gap_before: of the fitted FRFs, without it.
        gap_after: with it.
        heldout_before: of the others; None where there is none.
        heldout_after: likewise.
        sentences: the same in words, and what these data cannot tell.
        directions: of a stiffness that has values of its own along x, along y and in twist; none of all else.
    """

    kind: str
    place: tuple[float, float]
    spread: tuple[float, float]
    others: tuple[tuple[float, float], ...]
    total: float
    unit: str
    n_x: int
    n_y: int
    values: tuple[float, ...]
    form: str
    strength: float
    probability: Mapping[str, float]
    gap_before: float
    gap_after: float
    heldout_before: float | None
    heldout_after: float | None
    sentences: tuple[str, ...] = ()
    directions: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        places = [{"x": x, "y": y} for x, y in (self.place, *self.others)]
        return dict(vars(self)) | {
            "place": places[0],
            "others": places[1:],
            "spread": {"x": self.spread[0], "y": self.spread[1]},
            "total": {"value": self.total, "unit": self.unit},
            "values": list(self.values),
            "probability": dict(self.probability),
            "sentences": list(self.sentences),
            "directions": list(self.directions),
        }


@dataclass(frozen=True)
class Diagnosis:
    """What a diagnosis found.

    Attributes:
        verdict: "consistent", "explained", "partly_explained" or "unexplained".
        effects: what was missing, in the order of adding.
        gap: of the baseline and of the last model.
        location: where the baseline disagrees.
        scores: the score tables, one for each step.
        steps: the gap step by step.
        missing: what is left without a name: where, in which band, of which kind, how big; empty if nothing is.
        remarks: other sentences that a reader must know: tolerance broken, a parameter at its bound, a prior.
        next_measurements: what would part equivalents, or show what is missing, the cheapest first.
        parameters: the fitted parameters of the last model, "label.name" → estimate.
        model: the last model, all numbers.
        overlay: for figures; None where natural frequencies alone were measured.
        n_evaluation: FRF evaluations.
        seconds: it took.
        doubts: the hypotheses behind each name, for whoever plans a further test; none of a table.
        field: what is missing as a field without a name, where nothing of the catalogue accounts for it; None where
            none was looked for, or none helps. The last model holds it, and numbers fitted beside it.
    """

    verdict: Verdict
    effects: tuple[Named, ...]
    gap: Gap
    location: Location
    scores: tuple[tuple[Scored, ...], ...]
    steps: tuple[Step, ...]
    missing: tuple[str, ...]
    remarks: tuple[str, ...]
    next_measurements: tuple[str, ...]
    parameters: Mapping[str, Estimate]
    model: PlateModel
    overlay: Overlay | None
    n_evaluation: int = 0
    seconds: float = 0.0
    settings: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()
    field: FoundField | None = None

    def to_dict(self) -> dict[str, Any]:
        """The content of `diagnosis.json`, but for the name of the model's file."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "effects": [effect.to_dict() for effect in self.effects],
            "gap": self.gap.to_dict(),
            "location": self.location.to_dict(),
            "next_measurements": list(self.next_measurements),
            "missing": list(self.missing),
            "remarks": list(self.remarks),
            "parameters": {name: found.to_dict() for name, found in self.parameters.items()},
            "steps": [vars(step) for step in self.steps],
            "scores": [
                [vars(row) | {"options": dict(row.options), "twins": list(row.twins)} for row in table]
                for table in self.scores
            ],
            "n_evaluation": self.n_evaluation,
            "seconds": self.seconds,
            "field": None if self.field is None else self.field.to_dict(),
        }
