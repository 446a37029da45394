"""Broken files are refused in one sentence: a sample here, and more on request.

TORCHPLATE_MUTATIONS=20000 python -m pytest tests/trust/test_fuzz.py -m check -s
"""

import importlib
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from torchplate.cli.config import InputError, read_config
from torchplate.measurement import MeasurementError, read_measurement, read_nodes, read_recordings
from torchplate.search import OPTIMIZERS

DRIVER = Path(__file__).parent / "fuzzing.py"
MUTATIONS = int(os.environ.get("TORCHPLATE_MUTATIONS", "2000"))


def fuzzed(n: int, seed: int) -> None:
    # A process of its own: its limit of memory is its own, and its children are forked from no threads.
    ended = subprocess.run(
        [sys.executable, str(DRIVER), "--mutations", str(n), "--seed", str(seed)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    print(ended.stdout)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    files, readings, refused, read = map(
        int,
        re.search(
            r"(\d+) mutated files, (\d+) readings: (\d+) refused in one sentence, (\d+) read", ended.stdout
        ).groups(),
    )
    assert files >= n
    assert refused + read == readings
    # Neither does everything pass nor is everything refused.
    assert min(refused, read) > 0.05 * readings


def test_mutated_files_are_read_or_refused_in_one_sentence():
    fuzzed(20, 11)


@pytest.mark.check
def test_many_mutated_files_are_read_or_refused_in_one_sentence():
    fuzzed(MUTATIONS, 12)


def test_each_file_of_the_corpus_is_read_by_a_reader_and_each_reader_reads_one(tmp_path, monkeypatch):
    # Else the files would be refused for what they are, and mutations of them would never get far.
    monkeypatch.syspath_prepend(DRIVER.parent)
    fuzzing = importlib.import_module("fuzzing")
    read, unread = set(), []
    for name in fuzzing.corpus(tmp_path):
        outcomes = []
        for number, reader in enumerate(fuzzing.readers(name)):
            try:
                reader(tmp_path / name)
                outcomes.append(number)
            except (InputError, MeasurementError):
                pass
        read |= {(Path(name).suffix, number) for number in outcomes}
        unread += [] if outcomes else [name]
    assert not unread
    for suffix in (".uff", ".npz", ".csv", ".mat", ".wav", ".lvm", ".yaml"):
        missing = [n for n in range(len(fuzzing.readers(f"hit{suffix}"))) if (suffix, n) not in read]
        assert not missing, (suffix, missing)


GREEDY = """
import sys
sys.path.insert(0, {folder!r})
import fuzzing
fuzzing.BATCH = 6
fuzzing.readers = lambda _: [lambda _: bytearray({size}), lambda _: None]
sys.argv = ["fuzzing.py", "--mutations", "1", "--only", "nodes.csv"]
sys.exit(fuzzing.main())
"""


@pytest.mark.check
@pytest.mark.parametrize(("mebibytes", "status"), [(0, 0), (150, 0), (1100, 1)])
def test_what_a_reading_takes_of_the_memory_is_seen(mebibytes, status):
    script = GREEDY.format(folder=str(DRIVER.parent), size=mebibytes * 2**20)
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == status, ended.stdout + ended.stderr
    told = int(re.search(r"a reading takes (\d+) MiB at most", ended.stdout)[1])
    # All readings of the batch take as much, each of it anew; the last asks for more than there is.
    assert abs(told - mebibytes) <= 2 if status == 0 else "finding: MemoryError" in ended.stdout


BOMBS = {
    "anchors of anchors": "a: &a [1,1,1,1,1,1,1,1,1]\n"
    + "".join(
        f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
    ),
    "an anchor within itself": "mesh: &a {n_x: *a}\n",
    "brackets without end": "mesh: " + "[" * 3000,
    "levels without end": "mesh: " + "[" * 300 + "]" * 300,
    "a date that is none": "mesh: {n_x: 2001-99-99}\n",
    "a number that is too long": f"mesh: {{n_x: {'9' * 5000}}}\n",
}


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.check
def test_a_config_that_swells_is_refused(tmp_path, name):
    path = tmp_path / "plate.yaml"
    path.write_text(BOMBS[name])
    with pytest.raises(InputError, match=r"plate\.yaml: ") as refused:
        read_config(path)
    assert "\n" not in str(refused.value)


@pytest.mark.check
def test_an_override_that_swells_is_refused(bench, make_config, command):
    path = bench.write(make_config())
    for value in ("[" * 3000, "&a [*a]", "2001-99-99"):
        status, _, stderr = command("run", path, "--set", f"search.seed={value}", "--out", bench.folder / "out")
        assert status == 2
        assert stderr.count("\n") == 1


def test_an_archive_that_swells_is_refused(bench):
    path = bench.folder / "plate.npz"
    held = dict(np.load(path))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, array in [one for one in held.items() if one[0] != "notes"]:
            with packed.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array)
        with packed.open("notes.npy", "w", force_zip64=True) as file:
            for _ in range(300):
                file.write(bytes(2**20))
    assert path.stat().st_size < 2**20
    with pytest.raises(MeasurementError, match=r"that say they hold 3\.1\de\+08"):
        read_measurement(path)


def test_a_defect_in_a_reader_is_told_with_the_file(tmp_path):
    path = tmp_path / "nodes.csv"
    path.write_text("1e400, 0, 0\n")
    with pytest.raises(MeasurementError, match=r"nodes\.csv: expected a table of nodes, got one that does not parse"):
        read_nodes(path)


@pytest.mark.parametrize(
    "optimizer",
    [
        name
        if name in ("differential_evolution", "artificial_bee_colony")
        else pytest.param(name, marks=pytest.mark.check)
        for name in sorted(set(OPTIMIZERS))
    ],
)
@pytest.mark.check
def test_every_search_goes_on_from_its_own_checkpoint_and_from_none_that_was_changed(
    bench, make_config, command, optimizer
):
    search = {"optimizer": optimizer, "n_member": 8, "n_generation": 6, "tolerance": None, "n_repeat": 2}
    path, out = bench.write(make_config(["plate.youngs_modulus"], {"search": search})), bench.folder / "out"
    assert command("run", path, "--out", out, "--set", "search.n_generation=3")[0] == 0
    whole = torch.load(out / "checkpoint.pt", weights_only=True)
    changes = {
        "another part": {**whole, "more": torch.zeros(1)},
        "a part less": {key: value for key, value in whole.items() if key != "ledger.status"},
        "no tensor": {**whole, "generation": 3},
        "members outside": {**whole, "state.population": whole["state.population"] + 2},
        "no numbers": {**whole, "state.population": whole["state.population"] * torch.nan},
        "another shape": {**whole, "state.fitness": whole["state.fitness"][:, :-1]},
        "a status that is none": {**whole, "ledger.status": whole["ledger.status"] + 50},
    }
    for name, held in changes.items():
        torch.save(held, out / "checkpoint.pt")
        status, _, stderr = command("run", path, "--out", out, "--resume")
        assert (status, stderr.count("\n")) == (2, 1), name
        assert "checkpoint" in stderr
    torch.save(whole, out / "checkpoint.pt")
    assert command("run", path, "--out", out, "--resume")[0] == 0


def test_a_mat_file_of_a_type_that_the_format_has_not_is_refused_before_scipy_crashes(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "hit.mat"
    for compressed in (False, True):
        hit = np.zeros((64, 3))
        hit[10] = 1.0
        savemat(path, {"force": hit[:, 0], "acc": hit[:, 1:], "fs": 512.0}, do_compression=compressed)
        assert len(read_recordings(path)) == 1
    savemat(path, {"force": hit[:, 0], "acc": hit[:, 1:], "fs": 512.0})
    content = path.read_bytes()
    # The tag of the first array's numbers: doubles, type 9, and 512 bytes.
    tag = content.index(bytes([9, 0, 0, 0, 0, 2, 0, 0]))
    for kind in (0, 8, 10, 11, 19, 255):
        path.write_bytes(content[:tag] + bytes([kind]) + content[tag + 1 :])
        with pytest.raises(MeasurementError, match=rf"hit\.mat: expected a MAT file .*an element of type {kind}\)"):
            read_recordings(path)


def test_complex_places_are_refused(bench):
    path = bench.folder / "plate.npz"
    held = dict(np.load(path))
    for key in ("frequency", "response_coordinate", "reference"):
        np.savez(path, **held | {key: held[key] * 1j})
        with pytest.raises(MeasurementError, match="real numbers in "):
            read_measurement(path)
