"""What TensorBoard is told, and what a piped run says."""

import time
from io import StringIO

import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from torchplate.cli.build import SEARCHES
from torchplate.cli.heartbeat import Heartbeat

ONE = ["plate.youngs_modulus"]


def events(folder) -> EventAccumulator:
    found = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0})
    found.Reload()
    return found


def hparams(folder) -> tuple[set[str], dict[str, object]]:
    """The columns of the page that this run's folder asks for, and its own values."""
    columns, own = set(), {}
    for content in events(folder).summary_metadata.values():
        if content.plugin_data.plugin_name != "hparams":
            continue
        data = HParamsPluginData.FromString(content.plugin_data.content)
        columns |= {info.name for info in data.experiment.hparam_infos}
        for key, value in data.session_start_info.hparams.items():
            own[key] = getattr(value, value.WhichOneof("kind"))
    return columns, own


@pytest.fixture
def searched(bench):
    abc = {"search": {"optimizer": "artificial_bee_colony", "n_member": 6, "n_generation": 1}}
    return {
        "de": bench.run(ONE, {"search.n_generation": 1}, out="de").folder,
        "abc": bench.run(ONE, abc, out="abc").folder,
    }


def test_every_run_names_the_settings_of_every_search_and_fills_in_its_own(searched):
    every = {name for kind in SEARCHES.values() for name in vars(kind())}
    columns, own = {}, {}
    for name, folder in searched.items():
        columns[name], own[name] = hparams(folder)
    # Whichever of them TensorBoard meets first, no other loses a column.
    assert columns["de"] == columns["abc"] == {"optimizer", "seed"} | every
    assert own["de"]["differential_weight"] == 0.6
    assert own["de"]["crossover_rate"] == 0.9
    assert "differential_weight" not in own["abc"]
    assert own["abc"]["n_member"] == 6


def test_repeats_are_curves_of_their_own_with_one_tag(bench):
    found = bench.run(ONE, {"search.n_repeat": 3, "search.n_generation": 2, "search.tolerance": None})
    folders = sorted(path for path in found.folder.iterdir() if path.is_dir())
    assert [path.name for path in folders] == ["search_0", "search_1", "search_2"]
    ends = []
    for folder in folders:
        curve = events(folder).Scalars("search/best_objective")
        assert [point.step for point in curve] == [10, 20, 30]
        ends.append(curve[-1].value)
    assert sorted(ends) == pytest.approx(found.result["repeats"]["objective"], rel=1e-6)  # single precision


def test_a_folder_that_is_searched_anew_shows_each_repeat_once(bench):
    for _ in range(2):
        folder = bench.run(ONE, {"search.n_repeat": 2, "search.n_generation": 1}).folder
    assert [len(list((folder / f"search_{k}").glob("events.*"))) for k in range(2)] == [1, 1]


@pytest.mark.parametrize("count", [5, 8, 95, 98])
def test_a_resumed_curve_follows_in_the_same_second_and_after_the_clock_was_set_back(bench, monkeypatch, count):
    from tensorboard.summary.writer import event_file_writer

    # The names of event files are sorted as text: the 11th of a process stands before its 8th.
    monkeypatch.setattr(event_file_writer, "_global_uid", event_file_writer.AtomicCounter(count))
    searches = {"search.n_repeat": 2, "search.tolerance": None}
    for second, n_generation in ((2_000_000_000.0, 1), (2_000_000_000.5, 2), (1_999_999_000.0, 4)):
        monkeypatch.setattr(time, "time", lambda second=second: second)
        changes = searches | {"search.n_generation": n_generation}
        folder = bench.run(ONE, changes, resume=n_generation > 1).folder
    for home in (folder, folder / "search_0"):
        assert [point.step for point in events(home).Scalars("search/best_objective")] == [10, 20, 30, 40, 50]
        assert len(list(home.glob("events.out.tfevents.*"))) == 3


def test_curves_are_on_the_disk_before_the_checkpoint_that_follows_them(bench, monkeypatch):
    read = []
    monkeypatch.setattr(
        "torchplate.cli.log.save_checkpoint",
        lambda _, path: read.append(len(events(path.parent).Scalars("search/best_objective"))),
    )
    bench.run(ONE, {"search.n_generation": 3, "search.tolerance": None})
    assert read == [1, 2, 3, 4]


class TestHeartbeat:
    def test_a_pipe_is_told_where_the_search_stands_even_within_a_generation(self):
        said = StringIO()
        with Heartbeat(Console(file=said), 40, every=0.05) as line:
            time.sleep(0.3)
            line.beat(4, 0.25, 1200.0)
            time.sleep(0.3)
        lines = said.getvalue().splitlines()
        assert "preparing the first generation" in lines[0]
        assert "generation 4/40, best 0.25, 1200 evaluations/s" in lines[-1]
        assert lines[-1].endswith("left at most")

    def test_a_terminal_has_its_bar_and_no_lines(self):
        said = StringIO()
        with Heartbeat(Console(file=said, force_terminal=True), 40, every=0.02):
            time.sleep(0.1)
        assert said.getvalue() == ""

    def test_it_ends_with_the_search_whatever_ends_that(self):
        said = StringIO()
        line = Heartbeat(Console(file=said), 40, every=0.02)
        with pytest.raises(KeyboardInterrupt), line:
            raise KeyboardInterrupt
        before = said.getvalue()
        time.sleep(0.1)
        assert said.getvalue() == before

    @pytest.mark.parametrize("optimizer", ["least_squares", "differential_evolution"])
    def test_a_piped_search_says_lines(self, bench, make_config, command, monkeypatch, optimizer):
        monkeypatch.setattr("torchplate.cli.heartbeat.EVERY", 1e-3)
        search = {"optimizer": optimizer, "n_member": 6, "n_generation": 3}
        path = bench.write(make_config(["plate.youngs_modulus", "wires.stiffness"], {"search": search}))
        status, stdout, _ = command("run", path, "--out", bench.folder / "out")
        assert status == 0
        assert "evaluations/s" in stdout or "preparing" in stdout
