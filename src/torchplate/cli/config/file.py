"""A run is one YAML file: read and checked here.

The only file that imports yaml; `schema` says what the file may hold. Whatever the user wrote wrong comes back as one
InputError sentence that names the file, the key, what was expected and what came.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from torchplate.cli.schema import Config, ConfigError, validated, validated_states
from torchplate.measurement import FRF_SUFFIX
from torchplate.nearest import did_you_mean, nearest

MOST, DEEPEST = 100_000, 40
"""Values in a config, and levels of them; far more than anyone writes."""
LARGEST = 80 * MOST
"""Bytes of a config: a line of 80 letters for each of so many values."""


class InputError(ValueError):
    """The user's input cannot be used; the message is the whole sentence for stderr."""


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
    if path.suffix.lower() in FRF_SUFFIX:
        raise InputError(
            f"{path}: Expected a config (YAML), got the suffix of a measurement. Name the file in a config under "
            f"measurement.file; `torchplate inspect {path}` says what it holds."
        )
    if path.is_dir():
        held = ", ".join(sorted(other.name for other in path.glob("*.yaml"))[:4])
        which = f", as of {held}" if held else ""
        raise InputError(f"{path}: Expected a config file, got a folder. Give the path of a YAML file in it{which}.")
    if not path.is_file():
        near = nearest(path.name, [other.name for other in path.parent.glob("*.yaml")])
        guess = f" Did you mean {path.parent / near}?" if near else ""
        raise InputError(f"{path}: Expected a config file, found none.{guess} Give the path of a YAML file.")
    if (size := path.stat().st_size) > LARGEST:
        raise InputError(
            f"{path}: Expected a config of {LARGEST / 1e6:g} MB at most, got {size / 1e6:.3g} MB. Take out what is no "
            "key of a config: measurements have files of their own."
        )
    try:
        text = path.read_text(encoding="utf-8")
        node = yaml.compose(text, yaml.SafeLoader)
        if _size(node) > MOST:
            raise InputError(
                f"{path}: Expected a config, got YAML that grows to more than {MOST} values or is nested without end. "
                "Write it out without anchors."
            )
        raw, twice = yaml.safe_load(text), _given_twice(node)
    except (yaml.YAMLError, RecursionError, OverflowError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: {_no_yaml(error)}") from None
    if twice is not None:
        key, *lines = twice
        raise InputError(
            f"{path}: {key}: Expected each key once, got it in lines {lines[0]} and {lines[1]}. Keep one of them."
        )
    if (comma := _decimal_comma(node)) is not None:
        written, meant, line = comma
        raise InputError(f"{path}: Expected a decimal point, got {written} in line {line}. Write {meant}.")
    if (said := _other_base(node)) is not None:
        raise InputError(f"{path}: {said}")
    if not isinstance(raw, dict):
        came = "an empty file" if raw is None else "a list" if isinstance(raw, list) else f"the text {str(raw)[:40]!r}"
        raise InputError(f"{path}: Expected keys such as mesh and effects, got {came}. `torchplate keys` lists them.")
    raw = _numbers(raw)
    labels = list(raw.get("effects") or {})
    for override in overrides:
        _override(raw, override)
    for override in overrides:
        _of_an_effect_that_is_there(raw, override, labels)
    return raw, checked(path, raw)


def _no_yaml(error: Exception) -> str:
    """What is wrong with a text that is no YAML, and what to do."""
    if isinstance(error, UnicodeDecodeError):
        wide = error.object[:2] in (b"\xff\xfe", b"\xfe\xff")
        return f"Expected YAML in UTF-8, got {'UTF-16' if wide else 'another encoding'}. Save it as UTF-8."
    mark = getattr(error, "problem_mark", None)
    if mark is not None and "'\\t'" in str(getattr(error, "problem", "")):
        return f"Expected YAML, which is indented with blanks, got a tab in line {mark.line + 1}. Write blanks there."
    if mark is not None and "escape" in str(getattr(error, "problem", "")):
        return (
            "Expected YAML, where \\ between double quotes writes special characters, got one that is none in line "
            f"{mark.line + 1}. Write paths with / or in single quotes."
        )
    line = (mark.get_snippet(indent=0, max_length=200) or "").partition("\n")[0].strip() if mark is not None else ""
    if mark is not None and re.match(r"[\w.]+\s*=", line):
        return (
            f"Expected YAML, whose keys are written `key: value`, got {line!r} in line {mark.line + 1}. Write a colon."
        )
    if mark is not None and (said := _unpaired(error, line, mark.line + 1)):
        return said
    problem = " ".join(str(error).replace(' in "<unicode string>"', "").split())
    return f"Expected YAML, got a file that is not ({problem}). Correct it there."


def _unpaired(error: Exception, line: str, number: int) -> str:
    """What is wrong where a colon or a bracket is missing, or a line is too deep; empty where it is something else.

    Args:
        error: of PyYAML.
        line: where it gave up.
        number: of that line, from 1.
    """
    problem, opened = str(getattr(error, "problem", "")), getattr(error, "context_mark", None)
    began = (
        (opened.get_snippet(indent=0, max_length=200) or "").partition("\n")[0].strip() if opened is not None else ""
    )
    if opened is not None and "could not find expected ':'" in problem:
        return (
            f"Expected YAML, whose keys are written `key: value`, got {began!r} in line {opened.line + 1}. Write a "
            "colon and a blank."
        )
    if "expected a single document" in str(getattr(error, "context", "")):
        return f"Expected one config, got a second one from line {number} on. Give each a file of its own."
    if "mapping values are not allowed" in problem:
        return (
            f"Expected YAML, got {line!r} in line {number}, which may not stand below the line before it. End that one "
            "with a colon if it is a section, or begin both in one column."
        )
    if opened is not None and (closing := re.search(r"expected ',' or '([}\]])'", problem)):
        return (
            f"Expected YAML, got line {opened.line + 1}, {began!r}, whose bracket is not closed. Write "
            f"{closing.group(1)} or a comma where it lacks."
        )
    return ""


def _decimal_comma(node: yaml.Node | None) -> tuple[str, str, int] | None:
    """A decimal comma between brackets, where YAML takes the second half for another key: as written, mended, line."""
    if isinstance(node, yaml.SequenceNode):
        return next((found for item in node.value if (found := _decimal_comma(item))), None)
    if not isinstance(node, yaml.MappingNode):
        return None
    before = ""
    for key, value in node.value:
        if value.value == "" and re.fullmatch(r"\d+([eE][-+]?\d+)?", str(key.value)) and re.fullmatch(r"-?\d+", before):
            return f"{before},{key.value}", f"{before}.{key.value}", key.start_mark.line + 1
        if found := _decimal_comma(value):
            return found
        before = value.value if isinstance(value, yaml.ScalarNode) else ""
    return None


def _other_base(node: yaml.Node | None) -> str | None:
    """A number that YAML 1.1 takes to another base than people do, in a sentence: 011 is 9, 1:30 is 90."""
    if isinstance(node, yaml.ScalarNode):
        is_number = node.style is None and node.tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
        if is_number and re.fullmatch(r"[-+]?0[0-7_]+", node.value):
            base, meant = f"octal, {yaml.safe_load(node.value)}", node.value.replace("0", "", 1).lstrip("0_") or "0"
        elif is_number and ":" in node.value:
            base, meant = f"a number to the base 60, {yaml.safe_load(node.value):g}", "the number alone"
        else:
            return None
        where = f"{node.value} in line {node.start_mark.line + 1}"
        return f"Expected a decimal number, got {where}, which YAML takes as {base}. Write {meant}."
    inner = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else []
    inner = list(node.value) if isinstance(node, yaml.SequenceNode) else inner
    return next((found for one in inner if (found := _other_base(one))), None)


def _size(node: yaml.Node | None, depth: int = 0) -> int:
    """Values that YAML stands for once its anchors are followed; more than `MOST` of one that has no end.

    Anchors of anchors make a short text a large config.
    """
    if depth > DEEPEST:
        return MOST + 1
    inner = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else []
    inner = list(node.value) if isinstance(node, yaml.SequenceNode) else inner
    size = 1
    for one in inner:
        size += _size(one, depth + 1)
        if size > MOST:
            break
    return size


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
    """The config that a file says, each key and kind of value checked; of several states that of the first.

    Raises:
        InputError: if a key is unknown or has the wrong kind of value.
    """
    try:
        if isinstance(raw.get("measurement"), list):
            return next(iter([validated(alone) for _, alone in validated_states(raw)]))
        return validated(raw)
    except ConfigError as error:
        raise InputError(f"{path}: {error}") from None


def dump(raw: Mapping[str, Any]) -> str:
    """A config as YAML, in the order it was written."""
    return yaml.safe_dump(dict(raw), sort_keys=False, default_flow_style=None, allow_unicode=True, width=120)


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+|[-+]?(\d+\.\d*|\.\d+)[dD][-+]?\d+")
"""A number as people write it; Fortran's D before an exponent, as in 2.1D11, is an E."""


def _numbers(value: Any) -> Any:
    """PyYAML reads 2.1e11 and 1e-3 as text; the user meant numbers."""
    if isinstance(value, dict):
        return {key: _numbers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_numbers(inner) for inner in value]
    return float(re.sub("[dD]", "e", value)) if isinstance(value, str) and _NUMBER.fullmatch(value) else value


def _of_an_effect_that_is_there(raw: dict[str, Any], text: str, labels: Sequence[str]) -> None:
    """Refuse an override of an effect that neither the config holds nor the overrides name."""
    first, label, *rest = [*text.partition("=")[0].split("."), "", ""]
    effect = raw["effects"].get(label) if first == "effects" and isinstance(raw.get("effects"), dict) else None
    if rest[0] and label not in labels and isinstance(effect, dict) and "effect" not in effect:
        raise InputError(
            f"--set {text}: Expected an effect of the config, got '{label}'.{did_you_mean(label, labels)} It has: "
            f"{', '.join(map(str, labels))}; a new one needs --set effects.{label}.effect=NAME, too."
        )


def _override(raw: dict[str, Any], text: str) -> None:
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise InputError(f"--set {text}: Expected key.key=value, got no value. Write --set search.seed=3, say.")
    *parents, last = key.split(".")
    target = raw
    for parent in parents:
        if isinstance(target, dict) and parent == "measurement" and isinstance(target.get(parent), list):
            raise InputError(
                f"--set {text}: Expected one measurement, got a list of states. Change the file, or give a state's key "
                "there."
            )
        target = target.setdefault(parent, {})
        if not isinstance(target, dict):
            raise InputError(f"--set {text}: Expected {parent} to hold keys, got {target!r}. Shorten the key.")
    try:
        node = yaml.compose(value, yaml.SafeLoader)
        if _size(node) > MOST:
            raise InputError(f"--set {key}: Expected a value, got one that grows without end. Write it out.")
        target[last] = _numbers(yaml.safe_load(value))
        twice = _given_twice(node, key)
    except (yaml.YAMLError, RecursionError, OverflowError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"--set {text}: Expected a YAML value, got '{value}'. Put it in quotes.") from None
    if (said := _other_base(node)) is not None:
        raise InputError(f"--set {text}: {said}")
    if twice is not None:
        raise InputError(f"--set {text}: Expected each key once, got {twice[0]} twice. Keep one of them.")
