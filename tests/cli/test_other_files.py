"""Files that hold something else than FRFs get one sentence with what they are good for."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from torchplate.measurement import read_measurement
from torchplate.measurement.records.tables import READERS


def _mat(path: Path) -> None:
    lines = np.linspace(5, 400, 80)
    scipy.io.savemat(path, {"frequency": lines, "H": np.ones((80, 1, 2)) + 1j})


FILES = {
    "a table of natural frequencies": ("freq.csv", lambda p: p.write_text("mode;frequency\n1;41,3\n2;77,9\n")),
    "a list in a text file": ("freq.txt", lambda p: p.write_text("41.3\n77.9\n101.2\n")),
    "FRFs of MATLAB": ("frf.mat", _mat),
    "a sound": ("hit.wav", lambda p: p.write_bytes(b"RIFF")),
    "UTF-16": ("wide.uff", lambda p: p.write_text("    -1\n    58\n    -1\n", encoding="utf-16")),
}
SAID = {
    "a table of natural frequencies": "measurement: {natural_frequencies: {1: 41.3, 2: 77.9}}",
    "a list in a text file": "measurement: {natural_frequencies: {1: 41.3, 2: 77.9}}",
    "FRFs of MATLAB": "torchplate frf FILE --response 3 --reference 28 102 --out FRFS.uff",
    "a sound": "`torchplate frf`",
    "UTF-16": "got UTF-16. Save it as ASCII",
}


@pytest.mark.parametrize("name", FILES)
def test_new_says_what_the_file_is_good_for(name, command, tmp_path):
    file, write = FILES[name]
    write(tmp_path / file)
    status, _, error = command("new", tmp_path / file, "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert error.count("\n") == 1
    assert file in error
    assert SAID[name] in error


def _spreadsheet(path: Path) -> None:
    lines = np.linspace(5, 400, 80)
    rows = (f"{f};{3 + f};{f / 2};{f};{-f}".replace(".", ",") for f in lines)
    path.write_text("\n".join(["Frequency [Hz];Re 1 [m/s²/N];Im 1 [m/s²/N];Re 2 [m/s²/N];Im 2 [m/s²/N]", *rows]))


TABLES = {"MATLAB": ("frf.mat", _mat), "spreadsheet": ("frf.csv", _spreadsheet)}


@pytest.mark.parametrize("name", TABLES)
def test_frfs_in_a_table_are_described_named_and_go_on_to_a_config(name, command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file, write = TABLES[name]
    write(tmp_path / file)
    status, printed, _ = command("inspect", file)
    assert status == 0
    words = " ".join(printed.split())
    assert "2 FRFs of 80 lines, 5 to 400 Hz" in words
    assert f"torchplate frf {file} --response NODE --reference NODE ... --out FRFS.uff" in words
    (tmp_path / "nodes.csv").write_text("node,x,y\n3,0.02,0.03\n28,0.3,0.2\n102,0.38,0.27\n")
    told = ("--response", "3", "--reference", "28", "102", "--nodes", "nodes.csv", "--motion", "acceleration")
    status, printed, error = command("frf", file, *told, "--out", "plate.uff")
    assert status == 0, error
    assert printed.splitlines()[0].startswith(f"2 FRFs (accelerance) from {file}, 5 to 400 Hz, step 5 Hz: plate.uff")
    assert printed.splitlines()[-1] == "Next: torchplate new plate.uff"
    assert ("have no unit" in printed) == (name == "MATLAB")
    assert command("new", "plate.uff", "--length", "0.4", "0.3", "--out", "plate.yaml")[0] == 0
    read = read_measurement(tmp_path / "plate.uff")
    assert [one.node for one in read.reference] == [28, 102]
    assert complex(read.frf[0, 0, 1]) == (1 + 1j if name == "MATLAB" else 5 - 5j)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ((), ["2 FRFs", "none of the responses", "--response 3 --reference 28 102"]),
        (("--response", "3"), ["none of the references"]),
        (("--response", "3", "--reference", "28"), ["2 FRFs", "1 response and 1 reference"]),
    ],
)
def test_nodes_that_nobody_told_are_asked_for(told, words, command, tmp_path):
    _mat(tmp_path / "frf.mat")
    status, _, error = command("frf", tmp_path / "frf.mat", *told, "--out", tmp_path / "plate.uff")
    assert status == 2
    assert error.count("\n") == 1
    assert all(word in error for word in words), error


def test_one_table_for_each_hit_takes_the_node_from_its_name(command, tmp_path):
    lines = np.linspace(5, 400, 80)
    for node in (28, 102):
        scipy.io.savemat(tmp_path / f"point_{node}.mat", {"f": lines, "H": node * np.ones((80, 2)) + 1j})
    files = [tmp_path / f"point_{node}.mat" for node in (28, 102)]
    out = tmp_path / "plate.uff"
    status, printed, error = command("frf", *files, "--response", "3", "7", "--out", out)
    assert status == 0, error
    assert printed.startswith("4 FRFs")
    read = read_measurement(out)
    assert [one.node for one in read.response] == [3, 7]
    assert read.frf[0, 1].real.tolist() == [28, 102]


def test_inspect_of_a_table_of_natural_frequencies_says_where_they_go(command, tmp_path):
    (tmp_path / "freq.csv").write_text("mode;frequency\n1;41,3\n2;77,9\n3;101,2\n")
    status, _, error = command("inspect", tmp_path / "freq.csv")
    assert status == 2
    assert "measurement: {natural_frequencies: {1: 41.3, 2: 77.9}}" in error


def test_of_what_another_reader_says_the_first_clause_is_told(command, tmp_path, monkeypatch):
    def fails(path: Path) -> None:
        raise ValueError("no data segment found; the separator is another one. If the header has none, pass it " * 3)

    monkeypatch.setitem(READERS, ".lvm", fails)
    (tmp_path / "odd.lvm").write_text("nothing")
    assert "(no data segment found). Export it again" in command("inspect", tmp_path / "odd.lvm")[2]
