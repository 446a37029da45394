"""Files that hold something else than FRFs get one sentence with what they are good for."""

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from torchplate.measurement.record_tables import READERS


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
    "FRFs of MATLAB": "numpy.savez of frequency [n], frf [n, response, reference]",
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
