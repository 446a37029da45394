"""What a config may hold: every key with its kind, unit, default, meaning and an example.

The only file that imports pydantic. The reference of the documentation, `torchplate keys` and the sentences about
unknown keys all follow from the models below. `config` reads the file.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator

from torchplate.model import Searched
from torchplate.nearest import did_you_mean

# Titles of the pages of the documentation that are made from the models below and from the catalogue.
KEY_PAGE: Final = "Configuration"
EFFECT_PAGE: Final = "Effects"


class ConfigError(ValueError):
    """What is wrong with a config.

    Attributes:
        key: where.
        sentence: what was expected, what came, what to do.
    """

    def __init__(self, key: str, sentence: str) -> None:
        super().__init__(f"{key}: {sentence}")
        self.key, self.sentence = key, sentence


def key(meaning: str, unit: str = "-", *, example: Any, default: Any = ..., **limits: Any) -> Any:
    """A key of a config, as the reference tells it.

    Args:
        meaning: what it says, half a sentence.
        unit: SI unit, "-" for none.
        example: a value that could stand there.
        default: what holds where the key is left out; required if left out here.
        limits: of its value, as pydantic takes them.
    """
    return Field(default, description=meaning, examples=[example], json_schema_extra={"unit": unit}, **limits)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Known(_Strict):
    """A number, and how well it is known: `run` takes the value, `diagnose` weighs it."""

    value: float = key("the number", "as the key", example=0.48)
    std: float = key("its standard deviation", "as the key", example=0.0005, default=0.0, ge=0)


class Unknown(_Strict):
    """An interval to be searched; `[low, high]` for short."""

    low: float = key("lower end", "as the key", example=1.0e-5)
    high: float = key("upper end", "as the key", example=1.0e-2)
    scale: Literal["linear", "log"] = key(
        "whether the search sees equal differences or equal ratios as equal steps", example="log", default="linear"
    )

    @model_validator(mode="after")
    def _ends_in_order(self) -> "Unknown":
        Searched(self.low, self.high, self.scale == "log")
        return self


class MeshConfig(_Strict):
    """The plate and its elements."""

    length_x: Known = key("side along x; the sides are not searched", "m", example=0.48)
    length_y: Known = key("side along y", "m", example={"value": 0.48, "std": 0.0005})
    n_x: int = key("elements along x, which also number the nodes", example=10, gt=0)
    n_y: int = key("elements along y", example=10, gt=0)
    refine: int = key("splits each element in refine × refine; no label changes", example=2, default=1, gt=0)
    edges: dict[str, Literal["free", "simply_supported", "clamped"]] = key(
        "how the edges x0, x1, y0, y1 are held; those left out are free", example={"x0": "clamped"}, default={}
    )
    extrapolate: bool = key(
        "takes the error of the mesh off natural frequencies and mode shapes, from a mesh twice as fine",
        example=True,
        default=False,
    )
    cut: list[tuple[float, float, float, float]] = key(
        "holes and missing corners [x0, y0, x1, y1], on lines of the mesh: their elements are left out",
        "relative to the plate",
        example=[[0.3, 0.4, 0.5, 0.6]],
        default=[],
    )

    @field_validator("length_x", "length_y", mode="before")
    @classmethod
    def _length(cls, value: Any) -> Any:
        found = quantity(value)
        if isinstance(found, Unknown):
            raise ValueError("a number in m, since the sides of the plate are not searched (an effect may change them)")
        return found


class FrameConfig(_Strict):
    """Where the plate lies in the coordinates of the file."""

    unit: Literal["m", "cm", "mm", "in"] = key("of the coordinates and of `origin`", example="mm", default="m")
    origin: tuple[float, float, float] = key(
        "the plate's corner (0, 0)", "`unit`", example=[-240.0, -240.0, 0.0], default=(0.0, 0.0, 0.0)
    )
    x_axis: tuple[float, float, float] = key(
        "direction of the side x, of any length", example=[0.0, 1.0, 0.0], default=(1.0, 0.0, 0.0)
    )
    y_axis: tuple[float, float, float] = key(
        "direction of the side y, at a right angle to it", example=[-1.0, 0.0, 0.0], default=(0.0, 1.0, 0.0)
    )


class ModalModelConfig(_Strict):
    """Natural frequencies with their mode shapes. Its points are placed by `nodes` and `frame`, as channels are."""

    file: Path = key(
        ".uff or .unv (datasets 55 or 2414), or a table .csv; counts from the config's folder", example="modes.uff"
    )
    frequency_std: float | None = key(
        "standard deviation of the frequencies, relative; 0.001 where nothing is said",
        example=0.002,
        default=None,
        gt=0,
    )
    shape_std: float | None = key(
        "standard deviation of the shapes, √(1 − MAC); 0.1 where nothing is said, a MAC of 0.99",
        example=0.05,
        default=None,
        gt=0,
    )


class MeasurementConfig(_Strict):
    """What was measured, and where. `response` and `reference` stand in where no file names them."""

    file: Path | None = key(
        ".uff or .unv (datasets 58, 15 or 2411) or .npz; counts from the config's folder",
        example="plate.uff",
        default=None,
    )
    nodes: Path | None = key("a table node, x, y[, z] for files without coordinates", example="nodes.csv", default=None)
    frame: FrameConfig | None = key(
        "where the plate lies in the file's coordinates; see below", example={"unit": "mm"}, default=None
    )
    band: tuple[float, float] | None = key("lines that count", "Hz", example=[5.0, 400.0], default=None)
    kind: Literal["receptance", "mobility", "accelerance", "transmissibility"] | None = key(
        "of the FRFs, where the file does not say; transmissibility is response over the motion of the held edges",
        example="accelerance",
        default=None,
    )
    gain: Literal["known", "unknown"] = key(
        "`unknown` fits a factor on all levels, where they carry no unit", example="unknown", default="known"
    )
    n_average: int | None = key(
        "records behind the coherence; makes it a standard error of each line", example=5, default=None, ge=2
    )
    natural_frequencies: dict[int, Known] | None = key(
        "mode number, counted from 1 with the rigid-body modes: frequency; alone or beside a file",
        "Hz",
        example={4: 68.4, 5: {"value": 97.1, "std": 0.1}},
        default=None,
    )
    modal_model: ModalModelConfig | None = key(
        "frequencies and mode shapes, paired with the model's by MAC; alone or beside a file; see below",
        example={"file": "modes.uff"},
        default=None,
    )
    response: list[int | tuple[float, float]] | None = key(
        "nodes or relative places of the sensors", "node or [-, -]", example=[3, [0.6, 0.7]], default=None
    )
    reference: list[int | tuple[float, float]] | None = key(
        "nodes or relative places of the forces", "node or [-, -]", example=[28, 102], default=None
    )
    position_std: float | None = key(
        "standard deviation of hits and sensors from their marks; 0.001 where nothing is said",
        "m",
        example=0.002,
        default=None,
        ge=0,
    )
    frequency_drift: float | None = key(
        "of all natural frequencies from record to record, relative; 1e-4 where nothing is said",
        example=2.0e-4,
        default=None,
        ge=0,
    )
    calibration_std: float | None = key(
        "of the level of each channel, relative; 0.01 where nothing is said", example=0.02, default=None, ge=0
    )
    damping_scatter: float | None = key(
        "of each mode's damping about its law, relative; 0.1 where nothing is said",
        example=0.15,
        default=None,
        ge=0,
    )

    @field_validator("natural_frequencies", mode="before")
    @classmethod
    def _plain_numbers(cls, value: Any) -> Any:
        """A number stands for {value: number}."""
        if not isinstance(value, Mapping):
            return value
        return {mode: entry if isinstance(entry, Mapping) else {"value": entry} for mode, entry in value.items()}


class StateConfig(MeasurementConfig):
    """One of several states of a plate: `measurement` is then a list. It has the keys of a single one, and these."""

    name: str = key(
        "of the state; its own parameters are label.parameter@name", example="after", pattern=r"^[A-Za-z0-9_-]+$"
    )
    own: list[str] = key(
        "searched parameters label.parameter that have a value of their own in this state; all others are common",
        example=["wires.stiffness"],
        default=[],
    )
    effects: dict[str, dict[str, Any]] = key(
        "label: effects of this state alone, beside the common ones or in their place; their parameters are its own",
        example={"magnet": {"effect": "point_mass", "x": 0.3, "y": 0.7, "mass": 0.024}},
        default={},
    )


# What a state has beside the keys of a single measurement.
STATE_KEYS: Final = ("name", "own", "effects")


class ObjectiveConfig(_Strict):
    """How the gap between model and measurement is measured."""

    kind: str = key("the measure; see below", example="log_amplitude", default="relative_frf_norm")
    natural_frequency_weight: float = key(
        "scales the part of natural frequencies beside FRFs", example=2.0, default=1.0, gt=0
    )


class SearchConfig(BaseModel):
    """The optimiser and when it stops. Its own settings stand beside these keys; see below."""

    model_config = ConfigDict(extra="allow", frozen=True)

    optimizer: str = key("the search; see below", example="artificial_bee_colony", default="differential_evolution")
    n_generation: int = key("generations at most", example=200, default=100, gt=0)
    n_evaluation: int | None = key("evaluations at most", example=3200, default=None, gt=0)
    tolerance: float | None = key(
        "stops when the members' objectives scatter by no more than this times their mean",
        example=1.0e-6,
        default=1e-8,
        ge=0,
    )
    stagnation: int | None = key(
        "stops after this many generations without improvement", example=30, default=None, gt=0
    )
    target: float | None = key("stops at this objective", example=0.1, default=None)
    seed: int = key("of the random numbers", example=3, default=0, ge=0, lt=2**63)
    n_repeat: int = key("independent searches, run at once; the best is the result", example=20, default=1, gt=0)
    polish: bool = key("finishes with least squares and keeps what is lower", example=True, default=False)
    basis: Literal["auto", "full"] = key(
        "`full` insists on all dofs instead of a reduced basis whose error is checked", example="full", default="auto"
    )
    precision: Literal["double", "single"] = key(
        "of the FRFs within the search; what was found is evaluated in double", example="single", default="double"
    )


class LogConfig(_Strict):
    """How much is drawn."""

    n_figure: int = key("times that FRFs are drawn to TensorBoard during a search", example=10, default=4, ge=0)
    n_panel: int = key("FRFs that each of these, and the report, shows", example=12, default=6, gt=0)


class ModalTestConfig(_Strict):
    """The virtual test that `simulate` makes."""

    analyser: str | dict[str, Any] = key(
        "a named analyser, or its settings; see below", example={"like": "sr785", "n_average": 10}, default="sr785"
    )
    hammer: dict[str, Any] = key("settings of the hammer; see below", example={"peak_force": 20.0}, default={})
    response: list[int | tuple[float, float]] | None = key(
        "sensors; those of `measurement`, else node 3", "node or [-, -]", example=[3], default=None
    )
    reference: list[int | tuple[float, float]] | None = key(
        "points that are hit; those of `measurement`, else every node",
        "node or [-, -]",
        example=[28, 102, 104],
        default=None,
    )
    kind: Literal["receptance", "mobility", "accelerance"] = key(
        "of the FRFs that are written", example="mobility", default="accelerance"
    )
    refine: int = key("splits the config's elements, so that the test has its own mesh", example=2, default=3, gt=0)
    extrapolate: bool = key("takes the error of that mesh off", example=False, default=True)
    seed: int = key("of the hits and the noise", example=1, default=0, ge=0, lt=2**63)


class Config(_Strict):
    """One run, whole."""

    mesh: MeshConfig = key(
        "the plate and its elements", example={"length_x": 0.48, "length_y": 0.48, "n_x": 10, "n_y": 10}
    )
    effects: dict[str, dict[str, Any]] = key(
        "label: what the model is made of, by the catalogue of effects",
        example={"magnet": {"effect": "point_mass", "x": 0.27, "y": 0.68, "mass": 0.024}},
    )
    measurement: MeasurementConfig = key(
        "what was measured", example={"file": "plate.uff"}, default=MeasurementConfig()
    )
    objective: ObjectiveConfig = key(
        "how the gap is measured", example={"kind": "log_amplitude"}, default=ObjectiveConfig()
    )
    search: SearchConfig = key("how it is made small", example={"n_member": 16}, default=SearchConfig())
    modal_test: ModalTestConfig = key(
        "the virtual test of `simulate`", example={"kind": "mobility"}, default=ModalTestConfig()
    )
    log: LogConfig = key("how much is drawn", example={"n_panel": 12}, default=LogConfig())

    @field_validator("measurement", mode="before")
    @classmethod
    def _first_state(cls, value: Any) -> Any:
        """Of several states the first; `validated_states` looks at all of them."""
        if not isinstance(value, list) or not value or not isinstance(value[0], Mapping):
            return value
        return {name: inner for name, inner in value[0].items() if name not in STATE_KEYS}


def quantity(value: Any) -> Known | Unknown:
    """A number, a number with its tolerance, or an interval.

    Raises:
        ValueError: for anything else, saying what was expected and what came.
    """
    try:
        return parse_quantity(value)
    except ValidationError as error:
        raise ValueError(first_complaint(error)[1]) from None
    except ValueError as error:
        raise ValueError(f"Expected {error}, got {value!r}.") from None


def parse_quantity(value: Any) -> Known | Unknown:
    """As `quantity`; the error says only what was expected."""
    if isinstance(value, list | tuple) and len(value) == 2:
        return Unknown(low=value[0], high=value[1])
    if isinstance(value, Mapping):
        return Known(**value) if "value" in value else Unknown(**value)
    if isinstance(value, bool | list | tuple):
        raise ValueError("a number, an interval [low, high], or {value: , std: }")
    try:
        return Known(value=value)
    except ValidationError:
        raise ValueError(f"a number, an interval [low, high], or {{value: , std: }}{_hint(value)}") from None


def _hint(value: Any) -> str:
    """What a text that is nearly a number lacks."""
    if not isinstance(value, str):
        return ""
    if re.fullmatch(r"\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*", value):
        return " with a decimal point, not a comma"
    if re.fullmatch(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*[^\d\s.,].*", value):
        return " alone, in SI units and without the unit"
    return ""


def typed(owner: type, name: str, value: Any) -> Any:
    """A setting in the type that its dataclass declares for it; lists become tuples.

    Raises:
        ValueError: if it is of another kind, saying what was expected and what came.
    """
    try:
        return _frozen(TypeAdapter(get_type_hints(owner)[name]).validate_python(value))
    except ValidationError as error:
        raise ValueError(first_complaint(error)[1]) from None


def _frozen(value: Any) -> Any:
    return tuple(_frozen(inner) for inner in value) if isinstance(value, list) else value


def unknown_key(name: str, known: Iterable[str], section: str = "") -> str:
    """The sentence for a key or name that nothing answers to: the nearest, all there are, and where each is explained.

    Args:
        name: what came.
        known: what could have come.
        section: of the config, for its part of the reference; "effects." and the name of an effect for that one's.
    """
    known = list(known)
    of_effect = section.startswith("effects.")
    words = f"torchplate effects {section.removeprefix('effects.')}" if of_effect else f"torchplate keys {section}"
    page = EFFECT_PAGE if of_effect else KEY_PAGE
    return (
        f"No key or name '{name}' here.{did_you_mean(name, known)} There are: {', '.join(known)}. "
        f"`{words.strip()}` explains each, as the page {page} of the documentation does."
    )


def validated(raw: Mapping[str, Any]) -> Config:
    """The config that a mapping says.

    Raises:
        ConfigError: if a key is unknown or has the wrong kind of value.
    """
    try:
        return Config.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(*first_complaint(error)) from None


def validated_states(raw: Mapping[str, Any]) -> list[tuple[StateConfig, dict[str, Any]]]:
    """The states that a list under `measurement` says, each with the config of a single test that it stands for.

    Raises:
        ConfigError: if a state, or the config with it, cannot be used.
    """
    items = raw["measurement"]
    if len(items) < 2:
        raise ConfigError(
            "measurement", f"Expected two states or more in a list, got {len(items)}. Add one, or leave the list out."
        )
    found: list[tuple[StateConfig, dict[str, Any]]] = []
    for place, item in enumerate(items, 1):
        where = f"measurement.{item.get('name', place)}" if isinstance(item, Mapping) else f"measurement.{place}"
        if not isinstance(item, Mapping):
            raise ConfigError(where, f"Expected the keys of a state, such as name and file, got {item!r}. Correct it.")
        try:
            state = StateConfig.model_validate(item)
        except ValidationError as error:
            key, sentence = first_complaint(error)
            raise ConfigError(f"{where}.{key}", sentence) from None
        if state.name in [other.name for other, _ in found]:
            raise ConfigError(where, f"Expected each state's name once, got '{state.name}' twice. Rename one of them.")
        effects = {**dict(raw.get("effects") or {}), **state.effects}
        alone = {key: value for key, value in item.items() if key not in STATE_KEYS}
        found.append((state, {**raw, "effects": effects, "measurement": alone}))
    return found


def first_complaint(error: ValidationError) -> tuple[str, str]:
    """Key and sentence of the first complaint."""
    first = error.errors()[0]
    where = [str(part) for part in first["loc"]]
    key = ".".join(where) or "config"
    given = first.get("input")
    if first["type"] == "extra_forbidden":
        section, known = _keys_at(error.title, where[:-1])
        return key, unknown_key(where[-1], known, section)
    if first["type"] == "missing":
        return key, "Expected a value, got none. Add it."
    message = str(first["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.removeprefix("Input should be ").replace("an instance of Sequence", "a list")
    if message.startswith(("Expected", "No ")):
        return key, message
    shown = "no finite number" if isinstance(given, float) and not math.isfinite(given) else repr(given)
    return key, f"Expected {message}, got {shown}. Correct it."


def _keys_at(root: str, where: Sequence[str]) -> tuple[str, list[str]]:
    """The section of the reference, and the keys, that a place of a config (or of the part with that name) has."""
    parts: dict[str, type[BaseModel]] = {"Known": Known, "Unknown": Unknown, "StateConfig": StateConfig}
    part: type[BaseModel] | None = parts.get(root, Config)
    section = "" if part is Config else "measurement" if part is StateConfig else "numbers"
    for name in where:
        # What is no key is an entry of a mapping or a list, or one of several types that a value may have.
        if part is None or name not in part.model_fields:
            continue
        part = model_in(part.model_fields[name].annotation)
        section = "numbers" if part is Known else f"{section}.{name}".strip(".")
    return section, list(part.model_fields) if part is not None else []


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The first model that a type is, may be or holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := model_in(inner)) is not None), None)
