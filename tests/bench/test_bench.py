"""The bench compares what is the same, and writes down what it saw."""

import json

import pytest
import torch
from rich.console import Console

from torchplate.bench import timing
from torchplate.bench.peer import Peer
from torchplate.bench.problem import LINES, RESPONSE, members, paper_model
from torchplate.bench.timing import interleaved
from torchplate.cli.verbs import bench as command
from torchplate.plate import Mesh

SOME = LINES[7::100]


def test_the_peer_makes_the_frfs_of_a_direct_solve() -> None:
    model = paper_model()
    theta = members(model, 2, seed=3)
    found, expected = Peer(model, SOME).generation(theta), model.frf_direct(theta, SOME)
    # Two ways to the same numbers, both in double precision; the wires' modes cost some digits.
    assert float(((found - expected).norm(dim=1) / expected.norm(dim=1)).max()) < 1e-8


@pytest.mark.parametrize("n_element", [10, 20])
def test_places_stay_where_they_are_on_a_finer_mesh(n_element: int) -> None:
    model = paper_model(n_element)
    where = Mesh(0.48, 0.48, 10, 10).places(RESPONSE)
    assert torch.equal(model.mesh.places(model.response), where)
    assert len(model.reference) == 6


def test_ways_take_turns_and_the_first_turn_does_not_count(monkeypatch) -> None:
    monkeypatch.setattr(timing, "TURN", 0.0)
    turns = []
    taken = interleaved({"a": lambda: turns.append("a"), "b": lambda: turns.append("b")}, n_repeat=3)
    assert turns == ["a", "b"] * 4
    assert set(taken) == {"a", "b"}


def test_a_short_way_runs_again_and_again_in_its_turn(monkeypatch) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr(timing.time, "perf_counter", lambda: float(next(clock)))
    monkeypatch.setattr(timing, "TURN", 5.0)
    turns = []
    taken = interleaved({"a": lambda: turns.append("a"), "b": lambda: turns.append("b")}, n_repeat=1)
    # A look at the clock is a second here: five of them to a turn, and one at its end.
    assert "".join(turns) == "aaaaabbbbb" * 2
    assert taken == {"a": 6 / 5, "b": 6 / 5}


def test_a_part_takes_the_place_of_what_was_written_of_it(tmp_path, monkeypatch) -> None:
    sizes = iter([1.0, 2.0])

    def found(part: str, n_thread: int) -> dict:
        return {"n_member": 4, "before_gib": 0.1, "peak_gib": next(sizes), "result_gib": 0.2}

    monkeypatch.setattr(command, "_in_own_process", found)
    (tmp_path / "bench.json").write_text(json.dumps({"gradient": {"1": "kept"}}))
    for size in (1.0, 2.0):
        command.bench(tmp_path, ["memory"], Console(quiet=True), force=True)
        written = json.loads((tmp_path / "bench.json").read_text())
        assert written["memory"]["1"]["peak_gib"] == size
        assert written["gradient"] == {"1": "kept"}


@pytest.mark.check
def test_a_part_that_fails_says_what_it_said() -> None:
    with pytest.raises(RuntimeError, match=r"(?s)part 'nothing' to end, got:.*KeyError"):
        command._in_own_process("nothing", 1)


def test_the_slopes_are_drawn_as_they_are() -> None:
    rows = [
        {"dofs": 363, "members": 1, "lines": 50, "FRFs": 1, "SciPy": 1.0, "shared modes": 0.1, "reduced basis": 0.2}
    ]
    rows.append({name: 2 * value for name, value in rows[0].items() if name != "SciPy"})
    figure = command.slopes_figure(dict.fromkeys(("mesh", "members", "lines", "FRFs"), rows))
    assert len(figure.axes) == 4
    scipy, *_ = figure.axes[0].lines
    assert list(scipy.get_xdata()) == [363]
