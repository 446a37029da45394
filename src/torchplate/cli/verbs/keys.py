"""Every key of a config, from the models that check it: for `torchplate keys` and the page of the documentation."""

import dataclasses
import re
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, Union, get_args, get_origin

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from torchplate.cli.config import InputError
from torchplate.cli.config.searches import SEARCHES
from torchplate.cli.progress.console import speaking
from torchplate.cli.schema import Config, Known, StateConfig, Unknown, model_in
from torchplate.discrepancy import OBJECTIVES
from torchplate.measurement import ANALYSERS, Analyser, Hammer
from torchplate.nearest import did_you_mean
from torchplate.search import BOUNDS, JACOBIANS, STRATEGIES

REQUIRED: Final = "required"
# What docstrings call by the name of a registry.
_REGISTRIES: Final[Mapping[str, Iterable[str]]] = {"STRATEGIES": STRATEGIES, "BOUNDS": BOUNDS, "JACOBIANS": JACOBIANS}
_WORDS: Final[Mapping[Any, str]] = {
    int: "whole number",
    float: "number",
    bool: "true or false",
    str: "text",
    Path: "path",
    Known: "number",
    Any: "value",
}


class Key(NamedTuple):
    """One key, as the reference tells it; `example` is a line of YAML."""

    name: str
    kind: str
    unit: str
    default: str
    meaning: str
    example: str


class Section(NamedTuple):
    """The keys of one place of a config; `choices` are the names that one of them may take, and what they mean."""

    about: str
    keys: tuple[Key, ...]
    choices: Mapping[str, str] = {}


def sections() -> dict[str, Section]:
    """Every section by its place in a config, the whole config first."""
    found = {"config": _section(Config), "numbers": Section(_NUMBERS, (*_section(Known).keys, *_section(Unknown).keys))}
    for name, field in Config.model_fields.items():
        part = model_in(field.annotation)
        if part is None:
            found[name] = _EFFECTS
            continue
        found[name] = _section(part)
        for inner, deeper in part.model_fields.items():
            if (model := model_in(deeper.annotation)) not in (None, Known):
                found[f"{name}.{inner}"] = _section(model)
        if name == "measurement":
            own = _section(StateConfig)
            found["measurement.state"] = own._replace(
                keys=tuple(one for one in own.keys if one.name not in part.model_fields)
            )
        if name == "objective":
            told = {kind: _sentence(measure.gap.__doc__) for kind, measure in OBJECTIVES.items()}
            found[name] = found[name]._replace(choices=told)
        if name == "search":
            told = {kind: _sentence(search.__doc__) for kind, search in SEARCHES.items()}
            found[name] = found[name]._replace(choices=told)
            found |= {
                f"search.{kind}": _settings(search, f"With `optimizer: {kind}`.") for kind, search in SEARCHES.items()
            }
        if name == "modal_test":
            like = f"The virtual analyser. `like` names one to start from: {', '.join(ANALYSERS)}."
            found["modal_test.analyser"] = _settings(Analyser, like)
            found["modal_test.hammer"] = _settings(Hammer, "The virtual hammer, which hits with half sines.")
    return found


_EFFECTS = Section(
    "What the model is made of: a label of your own, and under it an effect of the catalogue. `torchplate effects` "
    "lists the options and parameters of each.",
    (
        Key("effect", "text", "-", REQUIRED, "its name in the catalogue", "effect: point_mass"),
        Key("an option", "see the effect", "-", REQUIRED, "nodes, an edge, channels: never searched", "nodes: [2, 10]"),
        Key(
            "a parameter",
            "number or interval",
            "see the effect",
            "its neutral value",
            "required where there is no neutral value",
            "mass: [0.0, 0.05]",
        ),
    ),
)
_NUMBERS = (
    "A number is known and an interval is searched: `0.48`, `{value: 0.48, std: 0.0005}` for a number known as well as "
    "a ruler knows it, `[0.4, 0.5]` or `{low: 1.0e-5, high: 1.0e-2, scale: log}` for an interval."
)


def _section(model: Any) -> Section:
    keys = []
    for name, field in model.model_fields.items():
        extra = field.json_schema_extra or {}
        default = REQUIRED if field.is_required() else flow(field.default)
        keys.append(
            Key(
                name,
                _kind(field.annotation),
                str(extra.get("unit", "-")),
                "see there" if model_in(type(field.default)) else default,
                (field.description or "") + _limits(field.metadata),
                f"{name}: {flow((field.examples or [field.default])[0])}",
            )
        )
    return Section(_sentence(model.__doc__), tuple(keys))


def _settings(owner: Any, about: str) -> Section:
    """Of a frozen dataclass, whose docstring says what each is."""
    told = arguments_of(owner.__doc__ or "")
    types_of = typing.get_type_hints(owner)
    keys = []
    for field in dataclasses.fields(owner):
        meaning, unit = told[field.name], "-"
        if (written := re.search(r"\s*\[([^\d\]][^\]]*)\]", meaning)) is not None:
            unit, meaning = written[1], meaning.replace(written[0], "", 1)
        for registry, names in _REGISTRIES.items():
            meaning = re.sub(rf"a key of `{registry}`|`{registry}`", ", ".join(names), meaning)
        default = flow(field.default)
        keys.append(
            Key(
                field.name,
                _kind(types_of[field.name]),
                unit,
                default,
                meaning.rstrip("."),
                f"{field.name}: {'null' if field.default is None else default}",
            )
        )
    return Section(about, tuple(keys))


def arguments_of(docstring: str) -> dict[str, str]:
    """What a docstring's `Args` say of each argument, in one line each."""
    _, _, rest = docstring.partition("Args:\n")
    block = re.split(r"\n\s*\n", rest)[0]
    entries = re.findall(r"^ {8}(\w+): (.*(?:\n {9,}.*)*)", block, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def flow(value: Any) -> str:
    """A value as one line of YAML."""
    if value is None or value == {}:
        return "none" if value is None else "{}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{flow(name)}: {flow(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, float) and "e" in (text := repr(value)) and "." not in text:
        # YAML takes 1e-05 for text.
        return text.replace("e", ".0e")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(inner) for inner in value) + "]"
    return str(value)


def _kind(annotation: Any) -> str:
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return " or ".join(_kind(one) for one in inner if one is not type(None))
    if origin is Literal:
        return " or ".join(f"`{one}`" for one in inner)
    if origin is tuple:
        return "[" + ", ".join(_kind(one) for one in inner) + "]"
    if origin is list:
        return f"list of {_kind(inner[0])}"
    if origin is dict:
        return f"{{{'name' if inner[0] is str else _kind(inner[0])}: {_kind(inner[1])}}}"
    return _WORDS.get(annotation, "keys")


def _limits(metadata: Sequence[Any]) -> str:
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    said = [
        f"{words[name]} {getattr(one, name)}" for one in metadata for name in ("gt", "ge", "le") if hasattr(one, name)
    ]
    return f"; {', '.join(said)}" if said else ""


def _sentence(docstring: str | None) -> str:
    """The first paragraph of a docstring, in one line, without its source."""
    return " ".join((docstring or "").split("\n\n")[0].split()).split(" Source")[0]


def keys(chosen: Sequence[str] = (), console: Console | None = None) -> None:
    """Print the reference.

    Args:
        chosen: sections, each with those below it; all if left out.
        console: where it goes.

    Raises:
        InputError: if there is no such section.
    """
    console, every = console or speaking(), sections()
    for name in chosen:
        if name not in every:
            raise InputError(
                f"No section '{name}' in a config.{did_you_mean(name, every)} There are: {', '.join(every)}."
            )
    for name, section in every.items():
        if chosen and not any(name == one or name.startswith(f"{one}.") for one in chosen):
            continue
        console.print(f"[bold]{name}[/]  {escape(section.about)}")
        for key in section.keys:
            unit = "" if key.unit == "-" else f" [{key.unit}]"
            default = key.default if key.default == REQUIRED else f"default {key.default}"
            console.print(f"  [bold]{key.name}[/]{escape(unit)}, {escape(default)}: {escape(key.kind)}")
            console.print(Padding(escape(f"{key.meaning}. Example: {key.example}"), (0, 0, 0, 6), expand=False))
        for choice, meaning in section.choices.items():
            console.print(Padding(f"[bold]{choice}[/]: {escape(meaning)}", (0, 0, 0, 2), expand=False))
        console.print()
