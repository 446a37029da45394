"""A truth value is no number, wherever the config holds numbers: Python takes true for 1."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from torchplate.cli.config import InputError
from torchplate.cli.config.build import load_run
from torchplate.cli.schema import quantity
from torchplate.cli.verbs.keys import sections
from torchplate.cli.verbs.simulate import simulate
from torchplate.effects import CATALOGUE, options


def _first_number(value: Any, truth: bool) -> tuple[Any, bool]:
    """The same with its first number, a key's before its value's, replaced; and whether there was one."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return truth, True
    parts = list(value.items()) if isinstance(value, dict) else list(value) if isinstance(value, list | tuple) else []
    for place, part in enumerate(parts):
        changed, found = _first_number(part, truth)
        if found:
            whole = [*parts[:place], changed, *parts[place + 1 :]]
            return (dict(map(tuple, whole)) if isinstance(value, dict) else whole), True
    return value, False


def numbers() -> Iterator[tuple[str, str, Any]]:
    """Section, key and example of everything that the reference calls a number."""
    for section, told in sections().items():
        for key in told.keys:
            if "number" in key.kind and section not in ("numbers", "effects"):
                yield section, key.name, _read(yaml.safe_load(key.example)[key.name])


def _read(example: Any) -> Any:
    """YAML reads 1e-6 as text."""
    return float(example) if isinstance(example, str) else example


@pytest.mark.check
@pytest.mark.parametrize(("section", "name", "example"), list(numbers()))
@pytest.mark.parametrize("truth", [True, False])
def test_a_truth_value_is_refused_wherever_the_reference_has_a_number(
    bench, make_config, section, name, example, truth
):
    value, found = _first_number(example, truth)
    # Where the default, none, is the example, the number stands alone.
    assert found or example is None
    value = value if found else truth
    changes = {} if section == "measurement.frame" else {"search": {}}
    parts = section.split(".")
    if parts[0] == "search" and len(parts) > 1:
        changes["search"], section = {"optimizer": parts[1]}, "search"
    if section == "measurement.modal_model":
        changes[f"{section}.file"] = "modes.uff"
    # As YAML: JSON has no truth values before a colon.
    path = bench.write(yaml.safe_dump(make_config(changes=changes | {f"{section}.{name}": value})))
    read = partial(simulate, out=bench.folder / "test.uff") if section.startswith("modal_test") else searched
    with pytest.raises(InputError, match=rf"{name}.*: Expected .* got ({'true' if truth else 'false'},|{truth})"):
        read(path)


def searched(path: Path) -> object:
    """The search of a config."""
    return load_run(path).optimizer()


@pytest.mark.parametrize(
    "value", [True, [True, 2.0], {"value": True}, {"value": 2.0, "std": True}, {"low": 0.0, "high": True}]
)
def test_no_parameter_of_an_effect_is_a_truth_value(value):
    with pytest.raises(ValueError, match=r"Expected a number.*got (true|True)"):
        quantity(value)


def test_no_option_of_an_effect_that_is_a_number_is_a_truth_value(bench, make_config):
    assert "nodes" in options(CATALOGUE["support_spring"])
    path = bench.write(make_config(changes={"effects.wires.nodes": [2, True, 11]}))
    with pytest.raises(InputError, match=r"effects.wires.nodes: Expected .* number, got true"):
        load_run(path).parts()


def test_set_takes_no_truth_value_for_a_number(bench, make_config):
    with pytest.raises(InputError, match=r"mesh.n_x: Expected a whole number, got true, yes or on, which is none"):
        load_run(bench.write(make_config()), ("mesh.n_x=yes",))
    assert load_run(bench.write(make_config()), ("search.polish=yes",)).config.search.polish is True
