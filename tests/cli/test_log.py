"""What TensorBoard is told, and what a piped run says."""

import re
import time
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from tensorboard.backend.event_processing.data_provider import MultiplexerDataProvider
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.backend.event_processing.plugin_event_multiplexer import EventMultiplexer
from tensorboard.context import RequestContext
from tensorboard.plugins.base_plugin import TBContext
from tensorboard.plugins.custom_scalar.layout_pb2 import Layout
from tensorboard.plugins.hparams import get_experiment, list_session_groups
from tensorboard.plugins.hparams.api_pb2 import (
    DATA_TYPE_BOOL,
    DATA_TYPE_FLOAT64,
    DATA_TYPE_STRING,
    STATUS_RUNNING,
    STATUS_SUCCESS,
    STATUS_UNKNOWN,
    GetExperimentRequest,
    ListSessionGroupsRequest,
)
from tensorboard.plugins.hparams.backend_context import Context
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from torchplate.cli.config.searches import SEARCHES
from torchplate.cli.progress.heartbeat import Heartbeat
from torchplate.cli.progress.layout import problem_named

ONE = ["plate.youngs_modulus"]
# How a value of each type of column is written.
STATED = {DATA_TYPE_BOOL: "bool_value", DATA_TYPE_FLOAT64: "number_value", DATA_TYPE_STRING: "string_value"}


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


@pytest.mark.check
def test_every_run_names_the_settings_of_every_search_and_fills_in_its_own(searched):
    every = {name for kind in SEARCHES.values() for name in vars(kind())}
    columns, own = {}, {}
    for name, folder in searched.items():
        columns[name], own[name] = hparams(folder)
    # Whichever of them TensorBoard meets first, no other loses a column.
    assert columns["de"] == columns["abc"] == {"problem", "optimizer", "seed", "n_repeat"} | every
    assert own["de"]["differential_weight"] == 0.6
    assert own["de"]["crossover_rate"] == 0.9
    assert "differential_weight" not in own["abc"]
    assert own["abc"]["n_member"] == 6


def test_the_page_of_tensorboard_has_a_row_for_each_search_and_only_its_own_settings_in_it(searched):
    """As TensorBoard's own plugin reads the folder above an ABC and a DE run."""
    root = searched["de"].parent
    multiplexer = EventMultiplexer()
    for name, folder in searched.items():
        multiplexer.AddRun(str(folder), name)
    multiplexer.Reload()
    context = Context(TBContext(multiplexer=multiplexer, data_provider=MultiplexerDataProvider(multiplexer, str(root))))
    experiment = get_experiment.Handler(RequestContext(), context, "", GetExperimentRequest()).run()
    request = ListSessionGroupsRequest(
        allowed_statuses=[STATUS_SUCCESS, STATUS_RUNNING, STATUS_UNKNOWN], start_index=0, slice_size=10
    )
    groups = list_session_groups.Handler(RequestContext(), context, "", request).run().session_groups
    kinds = {info.name: info.type for info in experiment.hparam_infos}
    rows = {group.hparams["optimizer"].string_value: group.hparams for group in groups}
    assert set(rows) == {"differential_evolution", "artificial_bee_colony"}
    for name, row in rows.items():
        # What another search takes stays empty: at its default it would say what nobody used.
        own = {"problem", "optimizer", "seed", "n_repeat", *vars(SEARCHES[name]())}
        assert set(row) == own
        for key, value in row.items():
            assert STATED[kinds[key]] == value.WhichOneof("kind"), key
    assert {info.name.tag for info in experiment.metric_infos} == {"search/best_objective", "gap/baseline"}


def metrics(folder) -> set[str]:
    """What the page shows of results, by their tags."""
    contents = [one.plugin_data for one in events(folder).summary_metadata.values()]
    found = [HParamsPluginData.FromString(one.content) for one in contents if one.plugin_name == "hparams"]
    return {info.name.tag for data in found for info in data.experiment.metric_infos}


def layout(folder) -> dict[str, dict[str, list[str]]]:
    """The charts that a run asks for: the tags of each, by category and title."""
    read = events(folder)
    (event,) = read.Tensors("custom_scalars__config__")
    asked = Layout.FromString(event.tensor_proto.string_val[0])
    return {
        category.title: {
            chart.title: [
                *chart.multiline.tag,
                *(tag for one in chart.margin.series for tag in (one.value, one.lower, one.upper)),
            ]
            for chart in category.chart
        }
        for category in asked.category
    }


@pytest.mark.check
def test_no_curve_is_a_single_dot(searched, bench):
    polished = bench.run(ONE, {"search.n_generation": 1, "search.polish": True, "log.n_figure": 3}, out="polished")
    for folder in (*searched.values(), polished.folder):
        read = events(folder)
        for tag in read.Tags()["scalars"]:
            assert len({point.step for point in read.Scalars(tag)}) > 1, tag


@pytest.mark.check
def test_the_gap_is_a_curve_without_pictures_too(bench):
    """TensorBoard leaves out the outer twentieths of a chart's values: of two points it would show neither."""
    found = bench.run(ONE, {"search.n_generation": 12, "search.tolerance": None, "log.n_figure": 0})
    assert len(events(found.folder).Scalars("gap/baseline")) >= 12


def test_what_the_settings_led_to_are_the_ends_of_curves_that_are_there(bench):
    found = bench.run(ONE, {"search.n_generation": 2, "search.polish": True})
    read = events(found.folder)
    assert metrics(found.folder) == {"search/best_objective", "gap/baseline"}
    for tag, value in (("search/best_objective", "objective"), ("gap/baseline", "gap")):
        # Single precision, and a least-squares end near zero.
        assert read.Scalars(tag)[-1].value == pytest.approx(found.result[value], rel=1e-6, abs=1e-12)
        assert read.Scalars(tag)[-1].step == found.result["n_evaluation"]


@pytest.mark.check
def test_two_searches_of_one_problem_share_their_charts(searched):
    (asked, other) = (layout(folder) for folder in searched.values())
    assert asked == other
    (problem,) = asked
    assert problem == "plate"
    assert len(asked[problem]) == 3  # best objective, one parameter, gap
    for folder in searched.values():
        tags = events(folder).Tags()["scalars"]
        for wanted in (tag for chart in asked[problem].values() for tag in chart):
            assert any(re.match(wanted, tag) for tag in tags), wanted


@pytest.mark.check
def test_a_problem_is_the_config_and_what_was_set_in_it_but_for_the_search(bench):
    assert problem_named("plate", ["search.seed=3", "search={seed: 3}", "log.n_figure=0"]) == "plate"
    assert problem_named("plate", ["mesh.refine=2", "measurement.band=[20, 400]"]) == (
        "plate_mesh.refine_2_measurement.band_20_400"
    )
    folder = bench.run(ONE, {"search.n_generation": 1}, overrides=["search.seed=5", "mesh.refine=2"]).folder
    assert list(layout(folder)) == ["plate_mesh.refine_2"]


@pytest.mark.check
def test_curves_of_a_problem_are_the_quartiles_over_the_seeds(bench):
    changes = {"search.n_repeat": 5, "search.n_generation": 2, "search.tolerance": None}
    found = bench.run(ONE, changes)
    ends, read = found.result["repeats"], events(found.folder)
    values = {"best_objective": ends["objective"], ONE[0]: [theta[0] for theta in ends["theta"]]}
    for name, over_seeds in values.items():
        for quantile, part in {"lower_quartile": 0.25, "median": 0.5, "upper_quartile": 0.75}.items():
            curve = read.Scalars(f"problem/plate/{name}/{quantile}")
            assert [point.step for point in curve] == [10, 20, 30]
            # Single precision.
            assert curve[-1].value == pytest.approx(np.quantile(over_seeds, part), rel=1e-6)


@pytest.mark.check
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


@pytest.mark.check
def test_a_folder_that_is_searched_anew_shows_each_repeat_once(bench):
    for _ in range(2):
        folder = bench.run(ONE, {"search.n_repeat": 2, "search.n_generation": 1}).folder
    assert [len(list((folder / f"search_{k}").glob("events.*"))) for k in range(2)] == [1, 1]


@pytest.mark.parametrize("count", [8, *(pytest.param(count, marks=pytest.mark.check) for count in (5, 95, 98))])
@pytest.mark.check
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
        "torchplate.cli.progress.log.save_checkpoint",
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
    @pytest.mark.check
    def test_a_piped_search_says_lines(self, bench, make_config, command, monkeypatch, optimizer):
        monkeypatch.setattr("torchplate.cli.progress.heartbeat.EVERY", 1e-3)
        search = {"optimizer": optimizer, "n_member": 6, "n_generation": 3}
        path = bench.write(make_config(["plate.youngs_modulus", "wires.stiffness"], {"search": search}))
        status, stdout, _ = command("run", path, "--out", bench.folder / "out")
        assert status == 0
        assert "evaluations/s" in stdout or "preparing" in stdout
