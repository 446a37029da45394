"""What is said before a search is on the terminal of `run` and `diagnose`, one line each, and with callers."""

import importlib.metadata
import json
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

import torchplate
from torchplate.cli.config.build import load_run
from torchplate.cli.machine import installed
from torchplate.cli.main import main
from torchplate.cli.verbs.diagnose import diagnose
from torchplate.cli.verbs.run import run
from torchplate.measurement import Measurement

ROOT = Path(__file__).parents[2]
DE_KEYS = ["strategy", "differential_weight", "crossover_rate"]


def notes(printed: str) -> list[str]:
    return [line.strip() for line in printed.splitlines() if line.startswith("  Note: ")]


def test_a_run_says_how_channels_were_matched_and_what_was_left_out(bench, make_config):
    # A narrow terminal wraps nothing of it.
    frfs = Measurement.from_npz(bench.folder / "plate.npz")
    object.__setattr__(frfs, "notes", ("Left out a record [of many].",))
    frfs.to_npz(bench.folder / "plate.npz")
    printed = Console(file=StringIO(), width=60)
    found = run(bench.write(make_config()), bench.folder / "out", console=printed)
    said = notes(printed.file.getvalue())
    assert said[0].startswith("Note: Matched 2 responses and 3 references to the plate by node number")
    assert said[1] == "Note: Left out a record [of many]."
    assert tuple(line.removeprefix("Note: ") for line in said) == found.remarks


def test_a_run_that_fits_says_nothing_but_how_channels_were_matched(bench, make_config):
    found = bench.run(["plate.youngs_modulus", "loss.stiffness_loss_factor"], {"search.n_generation": 1})
    (remark,) = found.remarks
    assert remark.startswith("Matched")


@pytest.mark.check
def test_a_level_in_g_is_said_by_run_and_by_diagnose(bench, make_config, monkeypatch):
    bench.measure(gain=1 / 9.80665)
    path = bench.write(make_config(["plate.youngs_modulus"], {"search.n_generation": 1}))
    found = run(path, bench.folder / "out", console=Console(file=StringIO()))
    assert any("g that are labelled m/s²" in remark for remark in found.remarks)
    printed = Console(file=StringIO(), width=60)

    def stop(*_: object, **__: object) -> None:
        raise InterruptedError

    monkeypatch.setattr("torchplate.cli.verbs.diagnose.find_missing", stop)
    with pytest.raises(InterruptedError):
        diagnose(path, bench.folder / "diagnosis", console=printed)
    assert any("g that are labelled m/s²" in line for line in notes(printed.file.getvalue()))


REAL = sorted((ROOT / "configs" / "real").glob("*.yaml"))
TABLE = ROOT / "configs" / "measured_frequencies.yaml"


@pytest.mark.parametrize(
    "path",
    [REAL[0], *(pytest.param(path, marks=pytest.mark.check) for path in REAL[1:]), TABLE],
    ids=lambda path: path.stem,
)
def test_configs_of_measured_plates_are_right_and_pass_without_a_word(path):
    recipe = load_run(path)
    file = recipe.config.measurement.file
    if file is not None and not (path.parent / file).exists():
        pytest.skip(f"the measurement is not part of the project: {file}")
    frfs = recipe.measurement()
    told = set() if frfs is None else {recipe.placement(frfs).remark, *frfs.notes}
    assert set(recipe.remarks(recipe.model())) == told


@pytest.mark.check
@pytest.mark.parametrize(
    ("truth", "name"), [("virtual_plate", "steel_plate"), ("hidden_effect_truth", "hidden_effect")]
)
def test_configs_of_virtual_plates_pass_without_a_word_and_another_density_does_not(truth, name, command, tmp_path):
    command("simulate", ROOT / "configs" / f"{truth}.yaml", "--out", tmp_path / "test.uff")
    set_file = f"measurement.file={tmp_path / 'test.uff'}"
    right, wrong = (
        recipe.remarks(recipe.model())[1:]
        for density in (7860, 2700)
        for recipe in (load_run(ROOT / "configs" / f"{name}.yaml", [set_file, f"effects.plate.density={density}"]),)
    )
    assert right == ()
    (sentence,) = wrong
    assert "effects.plate.density" in sentence
    assert "(as of steel, stainless steel" in sentence


def test_natural_frequencies_alone_are_looked_at_too(bench, make_config):
    changes = {"measurement": {"natural_frequencies": {4: 700.0, 5: 900.0}}}
    recipe = load_run(bench.write(make_config(["plate.youngs_modulus"], changes)))
    (remark,) = recipe.remarks(recipe.model())
    assert "times the measured ones" in remark


class TestAnotherOptimizer:
    @pytest.mark.parametrize("name", ["artificial_bee_colony", "least_squares", "jde"])
    def test_drops_the_keys_of_the_file_s_own_and_says_so(self, bench, make_config, name):
        changes = {"search.target": 1e-9} if name == "least_squares" else {}
        path = bench.write(make_config(["plate.youngs_modulus"], changes))
        recipe = load_run(path, [f"search.optimizer={name}"])
        recipe.optimizer()
        (sentence,) = recipe.dropped
        for key in [*DE_KEYS, *(key.removeprefix("search.") for key in changes)]:
            assert (key in sentence) != (key in recipe.raw["search"])
        assert recipe.remarks(recipe.model())[0] == sentence
        assert "strategy" in sentence

    def test_saves_a_config_that_runs_by_itself(self, bench):
        bench.run(
            ["plate.youngs_modulus"],
            {"search.n_generation": 1},
            overrides=["search.optimizer=artificial_bee_colony"],
        )
        assert load_run(bench.folder / "out" / "config.yaml").dropped == ()

    @pytest.mark.parametrize(
        ("overrides", "key"),
        [
            (["search.optimizer=artificial_bee_colony", "search.strategy=rand/1/bin"], "search.strategy"),
            (["search.optimizer=artificial_bee_colony", "search.crossover=0.9"], "search.crossover"),
        ],
    )
    def test_refuses_what_was_set_with_it(self, bench, make_config, command, overrides, key):
        path = bench.write(make_config(["plate.youngs_modulus"]))
        arguments = [word for override in overrides for word in ("--set", override)]
        status, _, stderr = command("run", path, *arguments)
        assert status == 2
        assert key in stderr

    def test_refuses_a_key_of_the_file_that_no_optimizer_has(self, bench, make_config, command):
        path = bench.write(make_config(["plate.youngs_modulus"], {"search.crossover": 0.9}))
        status, _, stderr = command("run", path, "--set", "search.optimizer=artificial_bee_colony")
        assert status == 2
        assert "search.crossover" in stderr


class TestAKeyGivenTwice:
    @pytest.mark.parametrize(
        ("text", "key", "lines"),
        [
            ("search: {seed: 1}\nlog: {}\nsearch: {seed: 2}\n", "search", "lines 1 and 3"),
            ("search:\n  seed: 1\n  n_member: 5\n  seed: 2\n", "search.seed", "lines 2 and 4"),
            ("effects:\n  plate: {effect: plate,\n   density: 1, density: 2}\n", "effects.plate.density", "3 and 3"),
            ("measurement:\n  natural_frequencies: {4: 1.0, 4: 2.0}\n", "natural_frequencies.4", "2 and 2"),
        ],
    )
    def test_is_refused_with_its_lines(self, bench, command, text, key, lines):
        path = bench.write(text, "twice.yaml")
        status, _, stderr = command("run", path)
        assert status == 2
        assert len(stderr.splitlines()) == 1
        for word in ("twice.yaml", f"{key}:", lines, "Keep one"):
            assert word in stderr

    def test_in_an_override_is_refused(self, bench, make_config, command):
        path = bench.write(make_config())
        status, _, stderr = command("run", path, "--set", "search={seed: 1, seed: 2}")
        assert status == 2
        assert "search.seed twice" in stderr

    def test_in_an_anchor_and_where_it_is_merged_is_none(self, bench):
        path = bench.write("a: &x {seed: 1}\nsearch: {<<: *x, seed: 3}\n", "merged.yaml")
        # The first complaint is of what is missing.
        with pytest.raises(ValueError, match="mesh: Expected a value"):
            load_run(path)


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"torchplate {torchplate.__version__}\n"
    assert torchplate.__version__[0].isdigit()


def test_a_package_that_is_not_installed_still_runs_and_says_so(bench, make_config, monkeypatch):
    def version(name):
        if name == "torchplate-fem":
            raise importlib.metadata.PackageNotFoundError(name)
        return found(name)

    found = importlib.metadata.version
    monkeypatch.setattr(installed, "version", version)
    monkeypatch.delattr(torchplate, "__version__", raising=False)
    written = run(bench.write(make_config()), bench.folder / "out")
    assert json.loads((written.folder / "versions.json").read_text())["torchplate-fem"] == "not installed"
