"""A diagnosis that was stopped goes on from the descents it had made, and from no others."""

import json

import pytest
import torch

from torchplate.cli.folder import descents
from torchplate.cli.folder.opening import DESCENTS
from torchplate.search import Descent, Recall, least_squares, recalled, recalling

ONE = ["plate.youngs_modulus"]
ENOUGH = 2


def descent(value: float) -> Descent:
    start = torch.full((2, 1), value, dtype=torch.float64)
    return Descent(start, start / 2, start[:, 0], 7)


class TestRecall:
    def test_descents_are_recalled_in_their_order_and_what_follows_is_made(self):
        kept: list[int] = []
        past = [descent(0.2), descent(0.4)]
        with recalling(Recall(past, lambda done: kept.append(len(done)))):
            found = [recalled(descent(value).start, lambda v=value: descent(v)) for value in (0.2, 0.4, 0.6)]
        assert [known for _, known in found] == [True, True, False]
        for (one, _), value in zip(found, (0.2, 0.4, 0.6), strict=True):
            assert torch.equal(one.position, descent(value).position)
            assert one.n_evaluation == 7
        assert kept == [3]

    def test_another_start_ends_it(self):
        with recalling(Recall([descent(0.2), descent(0.4)], lambda _: None)):
            first = recalled(descent(0.3).start, lambda: descent(0.3))
            second = recalled(descent(0.4).start, lambda: descent(0.4))
        assert (first[1], second[1]) == (False, False)

    def test_nothing_is_recalled_unasked(self):
        assert not recalled(descent(0.3).start, lambda: descent(0.3))[1]


def test_descents_of_any_size_come_back_as_they_were(tmp_path):
    generator = torch.Generator().manual_seed(0)
    made = []
    for cost, (n_start, n) in enumerate([(3, 4), (1, 9), (2, 0), (8, 2)]):
        start, position, objective = (
            torch.rand(shape, generator=generator, dtype=torch.float64)
            for shape in ((n_start, n), (n_start, n), (n_start,))
        )
        made.append(Descent(start, position, objective, cost))
    file = descents.DescentFile(tmp_path / "descents.pt", {"config": "a"})
    file.keep(made)
    for back, one in zip(file.read(), made, strict=True):
        assert all(torch.equal(*pair) for pair in zip(back[:3], one[:3], strict=True))
        assert back.n_evaluation == one.n_evaluation


STOPPED: dict[str, bytes] = {}
"""What lies in the folder of a diagnosis that was stopped: made by the first test that asks for it."""


@pytest.fixture
def stopped(bench, make_config, command, monkeypatch):
    """A diagnosis that was stopped after ENOUGH descents, and how to see how many more are made."""
    monkeypatch.setattr(descents, "EVERY", 0.0)
    path, out = bench.write(make_config(ONE)), bench.folder / "out"
    made: list[int] = []

    def counted(*arguments, **settings):
        if len(made) == ENOUGH:
            raise KeyboardInterrupt
        made.append(1)
        return least_squares(*arguments, **settings)

    for room in ("problem", "joint"):
        monkeypatch.setattr(f"torchplate.diagnosis.{room}.least_squares", counted)
    if STOPPED:
        out.mkdir()
        for name, content in STOPPED.items():
            (out / name).write_bytes(content)
    else:
        assert command("diagnose", path, "--out", out)[0] == 130
        STOPPED.update({one.name: one.read_bytes() for one in out.iterdir()})
    made.clear()
    return path, out, made


def kept(out) -> list[torch.Tensor]:
    content = torch.load(out / DESCENTS, weights_only=True)
    return list(content["position"].split(content["shape"].prod(1).tolist()))


@pytest.mark.check
def test_it_goes_on_where_it_was_stopped(bench, stopped, command):
    path, out, made = stopped
    first = kept(out)
    assert len(first) == ENOUGH
    status, stdout, _ = command("diagnose", path, "--out", out, "--resume")
    assert status == 130  # stopped again
    assert f"{ENOUGH} descents are taken over" in stdout
    second = kept(out)
    assert len(second) == 2 * ENOUGH
    assert all(torch.equal(*pair) for pair in zip(first, second, strict=False))
    # One that nobody stopped makes the same.
    for _ in range(2):
        made.clear()
        command("diagnose", path, "--out", bench.folder / "other", *(["--resume"] if _ else []))
    assert all(torch.equal(*pair) for pair in zip(second, kept(bench.folder / "other"), strict=True))


@pytest.mark.check
def test_without_out_it_is_found_in_the_latest_folder(bench, stopped, command, monkeypatch):
    path, out, _ = stopped
    monkeypatch.chdir(bench.folder)
    home = bench.folder / "runs" / "plate"
    home.mkdir(parents=True)
    out.rename(home / "2026-01-01_00-00-00")
    status, stdout, _ = command("diagnose", path, "--resume")
    assert status == 130
    assert f"2026-01-01_00-00-00: {ENOUGH} descents" in stdout


@pytest.mark.parametrize(
    ("override", "key"), [("search.seed=9", "config"), ("measurement.band=[8.0, 300.0]", "config")]
)
def test_another_config_is_refused(stopped, command, override, key):
    path, out, _ = stopped
    status, _, stderr = command("diagnose", path, "--out", out, "--resume", "--set", override)
    assert status == 2
    assert f"Expected the {key} that" in stderr
    assert "--force" in stderr


def test_another_measurement_is_refused(bench, stopped, command):
    path, out, _ = stopped
    bench.measure(gain=1.001)
    status, _, stderr = command("diagnose", path, "--out", out, "--resume")
    assert status == 2
    assert "Expected the measurement that" in stderr


def test_a_broken_file_is_refused(stopped, command):
    path, out, _ = stopped
    whole = (out / DESCENTS).read_bytes()
    for content in (b"", b"nothing", whole[: len(whole) // 2]):
        (out / DESCENTS).write_bytes(content)
        status, _, stderr = command("diagnose", path, "--out", out, "--resume")
        assert status == 2
        assert stderr.count("\n") == 1
        assert DESCENTS in stderr


def test_nothing_is_written_over_unasked(stopped, command):
    path, out, _ = stopped
    status, _, stderr = command("diagnose", path, "--out", out)
    assert status == 2
    assert DESCENTS in stderr


def test_stopped_before_anything_was_kept_it_begins_anew_and_says_so(stopped, command):
    path, out, _ = stopped
    (out / DESCENTS).unlink()
    status, stdout, _ = command("diagnose", path, "--out", out, "--resume")
    assert status == 130
    assert "begins anew" in stdout


def test_where_nothing_was_begun_there_is_nothing_to_resume(bench, make_config, command):
    path = bench.write(make_config(ONE))
    for more in (["--out", bench.folder / "none"], []):
        status, _, stderr = command("diagnose", path, "--resume", *more)
        assert status == 2
        assert "Leave --resume out" in stderr


def test_one_that_has_ended_is_not_repeated(bench, make_config, command):
    out = bench.folder / "out"
    out.mkdir()
    (out / "diagnosis.json").write_text(json.dumps({}))
    status, stdout, _ = command("diagnose", bench.write(make_config(ONE)), "--out", out, "--resume")
    assert status == 0
    assert "has ended" in stdout
