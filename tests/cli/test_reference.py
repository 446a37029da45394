"""The reference of the config: every key told, each example taken, unknown keys pointed there."""

import re

import pytest
import yaml

from torchplate.cli.config import InputError, read_config
from torchplate.cli.main import main
from torchplate.cli.schema import Config, Known, Unknown, model_in
from torchplate.cli.schema.whole import SearchConfig
from torchplate.cli.verbs.keys import REQUIRED, arguments_of, flow, sections
from torchplate.nearest import nearest
from torchplate.search import LeastSquaresStatus, Status

SMALLEST = {"mesh": {"length_x": 0.4, "length_y": 0.3, "n_x": 4, "n_y": 3}, "effects": {"plate": {"effect": "plate"}}}
MODELS = {"config": Config, "numbers": Known, "interval": Unknown} | {
    name: found for name, field in Config.model_fields.items() if (found := model_in(field.annotation)) is not None
}
MODELS["measurement.frame"] = model_in(MODELS["measurement"].model_fields["frame"].annotation)
FIELDS = [(section, name) for section, model in MODELS.items() for name in model.model_fields]


@pytest.mark.parametrize(("section", "name"), FIELDS)
def test_every_key_has_a_meaning_a_unit_and_an_example_that_is_taken(section, name):
    model, field = MODELS[section], MODELS[section].model_fields[name]
    assert field.description
    assert field.json_schema_extra["unit"]
    needed = {other: told.examples[0] for other, told in model.model_fields.items() if told.is_required()}
    line = yaml.safe_load(f"{name}: {flow(field.examples[0])}")
    assert getattr(model.model_validate(needed | line), name) != field.default


@pytest.mark.parametrize("section", sections())
def test_every_key_of_every_section_is_told_whole(section):
    for key in sections()[section].keys:
        assert all(key), key
        assert key.example.startswith(("effect", "nodes", "mass", f"{key.name}: "))
        assert yaml.safe_load(key.example) is not None


def test_the_keys_are_those_that_a_config_may_hold():
    told = sections()
    for section, model in MODELS.items():
        if section not in ("numbers", "interval"):
            assert [key.name for key in told[section].keys] == list(model.model_fields)
    assert {key.default for key in told["mesh"].keys if key.name.startswith("n_")} == {REQUIRED}


def test_the_words_of_a_docstring_are_read_with_their_second_lines():
    told = arguments_of(
        "A thing.\n\n    Args:\n        a: one [m].\n        b: two\n            more.\n\n    Raises:\n        c: d."
    )
    assert told == {"a": "one [m].", "b": "two more."}


@pytest.mark.parametrize(
    ("key", "near", "page"),
    [
        ("mesh.lenght_x", "length_x", "torchplate keys mesh`"),
        ("measurement.frame.orgin", "origin", "torchplate keys measurement.frame`"),
        ("measurment", "measurement", "torchplate keys`"),
        ("search.n_genration", "n_generation", "torchplate keys search`"),
        ("effects.plate.densty", "density", "torchplate effects plate`"),
        ("objective.knd", "kind", "torchplate keys objective`"),
        ("mesh.length_x", "std", "torchplate keys numbers`"),
    ],
)
def test_an_unknown_key_names_the_nearest_and_where_the_keys_are_explained(key, near, page, tmp_path, capsys):
    path = tmp_path / "plate.yaml"
    path.write_text(yaml.safe_dump(SMALLEST))
    value = "{value: 1, sdt: 0}" if key == "mesh.length_x" else "1"
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--set", f"{key}={value}"]) == 2
    told = capsys.readouterr().err
    assert f"Did you mean '{near}'?" in told
    assert page in told
    assert "the page" in told
    # What the sentence points at is there.
    words = page.rstrip("`").split()[1:]
    assert main(words) == 0
    assert near in capsys.readouterr().out


def test_a_section_that_is_not_there_is_said(capsys):
    assert main(["keys", "mehs"]) == 2
    assert "Did you mean 'mesh'?" in capsys.readouterr().err


def test_a_config_that_is_nearly_named_is_guessed(tmp_path):
    (tmp_path / "steel_plate.yaml").write_text("mesh: {}")
    with pytest.raises(InputError, match=r"Did you mean .*steel_plate.yaml"):
        read_config(tmp_path / "steelplate.yaml")


def test_capitals_hide_no_name():
    assert nearest("MESH", ["effects", "mesh"]) == "mesh"
    assert nearest("banana", ["effects", "mesh"]) is None


@pytest.mark.parametrize("status", [*Status, *LeastSquaresStatus], ids=lambda one: f"{type(one).__name__}.{one.name}")
def test_how_a_search_ended_names_the_keys_of_a_config_as_they_are_written(status):
    """`n_generation` alone is no key: "Raise n_generation" was answered with another complaint."""
    for key in ("n_generation", "n_evaluation", "stagnation", "target"):
        if re.search(rf"\b{key}\b", status.value):
            assert f"search.{key}" in status.value
            assert key in SearchConfig.model_fields
