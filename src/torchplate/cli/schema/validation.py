"""From what a YAML file says to a checked config, or to one for each state."""

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from torchplate.cli.schema.complaint import ConfigError, first_complaint
from torchplate.cli.schema.measured import STATE_KEYS, StateConfig
from torchplate.cli.schema.whole import Config


def validated(raw: Mapping[str, Any]) -> Config:
    """The config that a mapping says.

    Raises:
        ConfigError: if a key is unknown or has the wrong kind of value.
    """
    try:
        return Config.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(*first_complaint(error, Config)) from None


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
            key, sentence = first_complaint(error, StateConfig, "measurement")
            raise ConfigError(f"{where}.{key}", sentence) from None
        if state.name in [other.name for other, _ in found]:
            raise ConfigError(where, f"Expected each state's name once, got '{state.name}' twice. Rename one of them.")
        effects = {**dict(raw.get("effects") or {}), **state.effects}
        alone = {key: value for key, value in item.items() if key not in STATE_KEYS}
        found.append((state, {**raw, "effects": effects, "measurement": alone}))
    return found
