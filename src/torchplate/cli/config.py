"""A run is one YAML file: read and checked here.

The only file that imports yaml and pydantic. Whatever the user wrote wrong comes back as one InputError sentence that
names the file, the key, what was expected and what came.
"""

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, field_validator, model_validator

from torchplate.model import Searched

# A measurement given where a config belongs.
NOT_CONFIGS = (".uff", ".unv", ".uf", ".npz")


class InputError(ValueError):
    """The user's input cannot be used; the message is the whole sentence for stderr."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Known(_Strict):
    """A number, and how well it is known: `run` takes the value, `diagnose` weighs it."""

    value: float
    std: float = Field(default=0.0, ge=0)


class Unknown(_Strict):
    """An interval to be searched."""

    low: float
    high: float
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _ends_in_order(self) -> "Unknown":
        Searched(self.low, self.high, self.scale == "log")
        return self


class MeshConfig(_Strict):
    """The plate and its elements; see `plate.Mesh`."""

    length_x: Known
    length_y: Known
    n_x: int = Field(gt=0)
    n_y: int = Field(gt=0)
    refine: int = Field(default=1, gt=0)
    edges: dict[str, Literal["free", "simply_supported", "clamped"]] = {}
    extrapolate: bool = False

    @field_validator("length_x", "length_y", mode="before")
    @classmethod
    def _length(cls, value: Any) -> Any:
        found = quantity(value)
        if isinstance(found, Unknown):
            raise ValueError("a number in m, since the sides of the plate are not searched (an effect may change them)")
        return found


class FrameConfig(_Strict):
    """Where the plate lies in the coordinates of the file; see `measurement.Frame`."""

    unit: Literal["m", "cm", "mm", "in"] = "m"
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    x_axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    y_axis: tuple[float, float, float] = (0.0, 1.0, 0.0)


class MeasurementConfig(_Strict):
    """What was measured, and where; `response` and `reference` stand in where no file names them."""

    file: Path | None = None
    nodes: Path | None = None
    frame: FrameConfig | None = None
    band: tuple[float, float] | None = None
    kind: Literal["receptance", "mobility", "accelerance", "transmissibility"] | None = None
    gain: Literal["known", "unknown"] = "known"
    n_average: int | None = Field(default=None, ge=2)
    natural_frequencies: dict[int, Known] | None = None
    response: list[int | tuple[float, float]] | None = None
    reference: list[int | tuple[float, float]] | None = None
    # What the test is not perfect in; see `measurement.Imperfections`.
    position_std: float | None = Field(default=None, ge=0)
    frequency_drift: float | None = Field(default=None, ge=0)
    calibration_std: float | None = Field(default=None, ge=0)
    damping_scatter: float | None = Field(default=None, ge=0)

    @field_validator("natural_frequencies", mode="before")
    @classmethod
    def _plain_numbers(cls, value: Any) -> Any:
        """A number stands for {value: number}."""
        if not isinstance(value, Mapping):
            return value
        return {mode: entry if isinstance(entry, Mapping) else {"value": entry} for mode, entry in value.items()}


class ObjectiveConfig(_Strict):
    """How the gap is measured; see `discrepancy.measure` and `discrepancy.natural_frequency`."""

    kind: str = "relative_frf_norm"
    natural_frequency_weight: float = Field(default=1.0, gt=0)


class SearchConfig(BaseModel):
    """The optimiser and when it stops; other keys are the optimiser's own settings."""

    model_config = ConfigDict(extra="allow", frozen=True)

    optimizer: str = "differential_evolution"
    n_generation: int = Field(default=100, gt=0)
    n_evaluation: int | None = Field(default=None, gt=0)
    tolerance: float | None = Field(default=1e-8, ge=0)
    stagnation: int | None = Field(default=None, gt=0)
    target: float | None = None
    seed: int = Field(default=0, ge=0, lt=2**63)
    n_repeat: int = Field(default=1, gt=0)
    polish: bool = False
    basis: Literal["auto", "full"] = "auto"
    precision: Literal["double", "single"] = "double"


class LogConfig(_Strict):
    """How often FRF figures go to TensorBoard in a search, and how many FRFs they and the report show."""

    n_figure: int = Field(default=4, ge=0)
    n_panel: int = Field(default=6, gt=0)


class ModalTestConfig(_Strict):
    """The virtual test of `simulate`; see `measurement.modal_test` and `measurement.analyser`."""

    analyser: str | dict[str, Any] = "sr785"
    hammer: dict[str, Any] = {}
    response: list[int | tuple[float, float]] | None = None
    reference: list[int | tuple[float, float]] | None = None
    kind: Literal["receptance", "mobility", "accelerance"] = "accelerance"
    refine: int = Field(default=3, gt=0)
    extrapolate: bool = True
    seed: int = Field(default=0, ge=0, lt=2**63)


class Config(_Strict):
    """One run, whole."""

    mesh: MeshConfig
    effects: dict[str, dict[str, Any]]
    measurement: MeasurementConfig = MeasurementConfig()
    objective: ObjectiveConfig = ObjectiveConfig()
    search: SearchConfig = SearchConfig()
    modal_test: ModalTestConfig = ModalTestConfig()
    log: LogConfig = LogConfig()


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


def read_config(path: Path, overrides: Sequence[str] = ()) -> tuple[dict[str, Any], Config]:
    """Read and check a config.

    Args:
        path: a YAML file.
        overrides: "key.key=value" each, the value in YAML.

    Returns:
        What the file says with the overrides in it, and the same checked.

    Raises:
        InputError: if the file is absent, is not YAML, or a key is unknown or has the wrong kind of value.
    """
    if path.suffix.lower() in NOT_CONFIGS:
        raise InputError(
            f"{path}: Expected a config (YAML), got the suffix of a measurement. Name the file in a config under "
            f"measurement.file; `torchplate inspect {path}` says what it holds."
        )
    if not path.is_file():
        near = difflib.get_close_matches(path.name, [p.name for p in path.parent.glob("*.yaml")], n=1)
        guess = f" Did you mean {path.parent / near[0]}?" if near else ""
        raise InputError(f"{path}: Expected a config file, found none.{guess} Give the path of a YAML file.")
    try:
        text = path.read_text()
        raw = yaml.safe_load(text)
        twice = _given_twice(yaml.compose(text, yaml.SafeLoader))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        problem = " ".join(str(error).split())
        raise InputError(f"{path}: Expected YAML, got a file that is not ({problem}). Correct it there.") from None
    if twice is not None:
        key, *lines = twice
        raise InputError(
            f"{path}: {key}: Expected each key once, got it in lines {lines[0]} and {lines[1]}. Keep one of them."
        )
    if not isinstance(raw, dict):
        raise InputError(f"{path}: Expected keys such as mesh and effects, got {type(raw).__name__}. See README.md.")
    raw = _numbers(raw)
    for override in overrides:
        _override(raw, override)
    return raw, checked(path, raw)


def _given_twice(node: yaml.Node | None, where: str = "") -> tuple[str, int, int] | None:
    """The first key that a mapping holds twice, which PyYAML takes in silence, and its two lines, counted from 1."""
    if isinstance(node, yaml.SequenceNode):
        return next((found for item in node.value if (found := _given_twice(item, where))), None)
    if not isinstance(node, yaml.MappingNode):
        return None
    lines: dict[str, int] = {}
    for key, value in node.value:
        name, line = str(key.value), key.start_mark.line + 1
        full = f"{where}.{name}" if where else name
        if name in lines:
            return full, lines[name], line
        lines[name] = line
        if (found := _given_twice(value, full)) is not None:
            return found
    return None


def checked(path: Path, raw: dict[str, Any]) -> Config:
    """The config that a file says, each key and kind of value checked.

    Raises:
        InputError: if a key is unknown or has the wrong kind of value.
    """
    try:
        return Config.model_validate(raw)
    except ValidationError as error:
        key, message = first_complaint(error)
        raise InputError(f"{path}: {key}: {message}") from None


def dump(raw: Mapping[str, Any]) -> str:
    """A config as YAML, in the order it was written."""
    return yaml.safe_dump(dict(raw), sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")


def _numbers(value: Any) -> Any:
    """PyYAML reads 2.1e11 and 1e-3 as text; the user meant numbers."""
    if isinstance(value, dict):
        return {key: _numbers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_numbers(inner) for inner in value]
    return float(value) if isinstance(value, str) and _NUMBER.fullmatch(value) else value


def _override(raw: dict[str, Any], text: str) -> None:
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(f"--set {text}: Expected key.key=value, got no value. Write --set search.seed=3, say.")
    *parents, last = key.split(".")
    target = raw
    for parent in parents:
        target = target.setdefault(parent, {})
        if not isinstance(target, dict):
            raise InputError(f"--set {text}: Expected {parent} to hold keys, got {target!r}. Shorten the key.")
    try:
        target[last] = _numbers(yaml.safe_load(value))
        twice = _given_twice(yaml.compose(value, yaml.SafeLoader), key)
    except yaml.YAMLError:
        raise InputError(f"--set {text}: Expected a YAML value, got '{value}'. Put it in quotes.") from None
    if twice is not None:
        raise InputError(f"--set {text}: Expected each key once, got {twice[0]} twice. Keep one of them.")


def unknown_key(name: str, known: Sequence[str] | Mapping[str, Any]) -> str:
    """The sentence for a key or name that nothing answers to, with the nearest one."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    guess = f" Did you mean '{near[0]}'?" if near else ""
    return f"No key or name '{name}' here.{guess} There are: {', '.join(known)}."


def first_complaint(error: ValidationError) -> tuple[str, str]:
    """Key and sentence of the first complaint."""
    first = error.errors()[0]
    where = [str(part) for part in first["loc"]]
    key = ".".join(where) or "config"
    given = first.get("input")
    if first["type"] == "extra_forbidden":
        return key, unknown_key(where[-1], _keys_at(error.title, where[:-1]))
    if first["type"] == "missing":
        return key, "Expected a value, got none. Add it."
    message = str(first["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.removeprefix("Input should be ").replace("an instance of Sequence", "a list")
    if message.startswith(("Expected", "No ")):
        return key, message
    shown = "no finite number" if isinstance(given, float) and not math.isfinite(given) else repr(given)
    return key, f"Expected {message}, got {shown}. Correct it."


def _keys_at(root: str, where: Sequence[str]) -> list[str]:
    """Keys that a config, or the part of it with that class name, may have at a place."""
    model: Any = {"Known": Known, "Unknown": Unknown}.get(root, Config)
    for part in where:
        if not hasattr(model, "model_fields"):
            # An entry of a mapping, or nothing: what the mapping holds.
            held = [inner for part_of in get_args(model) for inner in get_args(part_of)]
            model = next((inner for inner in held if hasattr(inner, "model_fields")), None)
            continue
        field = model.model_fields.get(part)
        if field is None:
            return []
        model = field.annotation
    return list(model.model_fields) if hasattr(model, "model_fields") else []
