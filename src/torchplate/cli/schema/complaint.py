"""What is wrong with a config, in one sentence: what was expected, what came, what to do, and where it is explained."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, get_args

from pydantic import BaseModel, ValidationError

from torchplate.cli.schema.numbers import Known
from torchplate.effects import CATALOGUE, Plate
from torchplate.nearest import did_you_mean
from torchplate.notation import shortened

# Titles of the pages of the documentation that are made from the models below and from the catalogue.
KEY_PAGE: Final = "Configuration"
EFFECT_PAGE: Final = "Effects"
# Kinds of values in the words of a user, by what pydantic calls it where another one came.
SHAPES: Final = dict.fromkeys(("tuple_type", "list_type", "sequence_str", "too_short", "too_long"), "a list") | (
    dict.fromkeys(("dict_type", "mapping_type", "model_type", "model_attributes_type"), "keys with values")
)
VALUES: Final = dict.fromkeys(("float_parsing", "float_type"), "a number alone, in SI units and without the unit") | (
    dict.fromkeys(("int_parsing", "int_type", "int_from_float"), "a whole number")
    | {"path_type": "the path of one file", "string_type": "a text"}
)
# Words of other programs for those of a config.
SYNONYMS: Final = {
    "fixed": "clamped",
    "pinned": "simply_supported",
    "hinged": "simply_supported",
    "acceleration": "accelerance",
    "inertance": "accelerance",
    "velocity": "mobility",
    "displacement": "receptance",
    "compliance": "receptance",
    "c": "clamped",
    "s": "simply_supported",
    "ss": "simply_supported",
    "f": "free",
    "acc": "accelerance",
    "millimeter": "mm",
    "millimetre": "mm",
    "meter": "m",
    "metre": "m",
    "inch": "in",
}

# Symbols of the field for the names of parameters. A damping ratio is half of a loss factor.
SYMBOLS: Final = {
    "e": "youngs_modulus",
    "nu": "poisson_ratio",
    "rho": "density",
    "h": "thickness",
    "t": "thickness",
    "eta": "stiffness_loss_factor",
    "beta": "stiffness_loss_factor",
    "k": "stiffness",
    "c": "viscous_damping",
    "m": "mass",
    # SciPy's, of its differential evolution.
    "popsize": "n_member",
    "population_size": "n_member",
    "maxiter": "n_generation",
    "mutation": "differential_weight",
    "recombination": "crossover_rate",
    "tol": "tolerance",
}
HALVES: Final = ("damping_ratio", "zeta", "damping")


class ConfigError(ValueError):
    """What is wrong with a config.

    Attributes:
        key: where.
        sentence: what was expected, what came, what to do.
    """

    def __init__(self, key: str, sentence: str) -> None:
        super().__init__(f"{key}: {sentence}")
        self.key, self.sentence = key, sentence


def first_complaint(error: ValidationError, root: type[BaseModel] | None = None, section: str = "") -> tuple[str, str]:
    """Key and sentence of the first complaint.

    Args:
        error: of pydantic.
        root: the part of a config that it is about; None where it is about none.
        section: of the reference that explains this part.
    """
    first = error.errors()[0]
    places, kind, given = list(first["loc"]), first["type"], first.get("input")
    if kind == "missing" and places and isinstance(places[-1], int):
        # A list that is too short: what is wrong is the list, not the value that it lacks.
        kind = "tuple_type"
        places.pop()
    as_key = bool(places) and places[-1] == "[key]"
    where = [str(part) for part in places[: len(places) - as_key]]
    key = ".".join(where) or "config"
    if kind == "extra_forbidden":
        if deeper := stands_elsewhere(root, where[-1], of_section=len(where) == 1):
            return key, misplaced(key, deeper)
        return key, unknown_key(where[-1], *_keys_at(root, section, where[:-1]))
    if kind == "missing":
        return key, "Expected a value, got none. Add it."
    if kind in SHAPES:
        example = _example(root, where)
        remedy = f"Write {where[-1]}: {example}, say" if example else "Correct it"
        most = first.get("ctx", {}).get("max_length") if kind == "too_long" else None
        return key, f"Expected {SHAPES[kind]}{f' of {most}' if most else ''}, got {shown(given)}. {remedy}."
    if as_key and kind in VALUES:
        quotes = f" Write '{where[-1]}', in quotes." if kind == "string_type" else " Correct it."
        return key, f"Expected {VALUES[kind].split(',')[0]} before the colon, got {shown(given)}.{quotes}"
    if kind in VALUES:
        return key, f"Expected {VALUES[kind]}, got {shown(given)}. Correct it."
    message = str(first["msg"]).removeprefix("Value error, ").removeprefix("Assertion failed, ")
    message = message.removeprefix("Input should be ").replace("an instance of Sequence", "a list")
    if message.startswith(("Expected", "No ")):
        return key, message
    named = SYNONYMS.get(given.strip().lower()) if kind == "literal_error" and isinstance(given, str) else None
    remedy = f"Write {named}" if named and f"'{named}'" in message else "Correct it"
    if message == "a list" and isinstance(given, int | float):
        # Of a list of places it is one coordinate of the first.
        remedy = "Write [[0.1, 0.2]], say: each place in brackets of its own" if places else f"Write [{given}]"
    return key, f"Expected {message}, got {shown(given)}. {remedy}."


def shown(given: object) -> str:
    """What came, as a sentence has it, cut where it is long: what YAML leaves empty is nothing."""
    if given is None:
        return "nothing"
    return "no finite number" if isinstance(given, float) and not math.isfinite(given) else shortened(repr(given))


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
    meant = did_you_mean(name, known)
    if (named := SYMBOLS.get(name.casefold())) in known:
        meant = f" Write {named}."
    if name.casefold() in HALVES and "stiffness_loss_factor" in known:
        meant = " Write stiffness_loss_factor, which is twice the damping ratio."
    return (
        f"No key or name '{name}' here.{meant} There are: {', '.join(known)}. "
        f"`{words.strip()}` explains each, as the page {page} of the documentation does."
    )


def misplaced(key: str, meant: str) -> str:
    """The sentence for a key that is known, but of another section."""
    return f"No key '{key}' here. Did you mean '{meant}'? Keys stand below their section."


def stands_elsewhere(root: type[BaseModel] | None, name: str, of_section: bool = True) -> str:
    """Where a key that a part of a config has not stands instead; empty where nothing has it.

    Args:
        root: the whole config.
        name: the key.
        of_section: it was given where the sections are, and may be that of an effect.
    """
    if root is None or "effects" not in root.model_fields:
        return ""
    if name in Plate.parameters:
        return f"effects.plate.{name}"
    if of_section and name in CATALOGUE:
        return f"effects.{name}"
    # What several sections have is told of a key above all of them alone: below one it may be another word's mistake.
    found = _keys_below(root, name)
    return "' or '".join(found) if of_section or len(found) == 1 else ""


def _keys_at(root: type[BaseModel] | None, section: str, where: Sequence[str]) -> tuple[list[str], str]:
    """The keys, and the section of the reference, that a place of a part of a config has."""
    part = root
    for name in where:
        # What is no key is an entry of a mapping or a list, or one of several types that a value may have.
        if part is None or name not in part.model_fields:
            continue
        part = model_in(part.model_fields[name].annotation)
        section = "numbers" if part is Known else f"{section}.{name}".strip(".")
    return list(part.model_fields) if part is not None else [], section


def _keys_below(root: type[BaseModel], name: str) -> list[str]:
    """Where keys of this name stand, a section and a name each."""
    return [
        f"{section}.{name}"
        for section, field in root.model_fields.items()
        if (part := model_in(field.annotation)) is not None and name in part.model_fields
    ]


def _example(root: type[BaseModel] | None, where: Sequence[str]) -> str:
    """What could stand at a place of a part of a config, as YAML has it; empty where the reference has none."""
    part, field = root, None
    for name in where:
        field = None if part is None else part.model_fields.get(name)
        part = None if field is None else model_in(field.annotation)
    if field is None:
        return ""
    if field.examples:
        return _as_yaml(field.examples[0])
    first = next(iter(part.model_fields.items()), None) if part is not None else None
    return f"{{{first[0]}: {_as_yaml((first[1].examples or [''])[0])}}}" if first is not None else ""


def _as_yaml(value: Any) -> str:
    """A value on one line, without the quotes that YAML does not need."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {_as_yaml(inner)}" for name, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_as_yaml(inner) for inner in value) + "]"
    return str(value)


def model_in(annotation: Any) -> type[BaseModel] | None:
    """The first model that a type is, may be or holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := model_in(inner)) is not None), None)
