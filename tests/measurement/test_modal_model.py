"""A modal model is read from datasets 55 and 2414 and from a table, and comes back from what is written."""

import math
from dataclasses import replace

import pytest
import pyuff
import torch

from torchplate.measurement import Channel, MeasurementError, ModalModel, describe, read_modal_model, write_modal_model

PLACES = ((0.0, 0.0, 0.0), (0.21, 0.0, 0.0), (0.21, 0.17, 0.0), (0.05, 0.17, 0.0))
REAL = torch.tensor([[1.0, -0.7, 0.9, -0.8], [0.3, 1.1, -0.2, -1.2]], dtype=torch.float64)
COMPLEX = REAL + 1j * torch.tensor([[0.01, 0.02, -0.03, 0.05], [0.1, 0.0, -0.04, 0.06]], dtype=torch.float64)


def made(shape=REAL, damping=(0.0031, 0.0127), places=PLACES) -> ModalModel:
    points = tuple(Channel(node, "w", place) for node, place in zip((3, 17, 8, 40), places, strict=True))
    ratio = torch.tensor(damping, dtype=torch.float64)
    return ModalModel(torch.tensor([41.237, 93.5], dtype=torch.float64), ratio, shape, points)


@pytest.mark.parametrize("shape", [REAL, COMPLEX], ids=["real", "complex"])
def test_a_modal_model_comes_back_from_datasets_55(tmp_path, shape):
    model, path = made(shape), tmp_path / "modes.uff"
    write_modal_model(model, path)
    found = read_modal_model(path)
    # Points are sorted by node, and the format has six digits.
    assert [one.node for one in found.point] == [3, 8, 17, 40]
    assert [one.coordinate for one in found.point] == [PLACES[0], PLACES[2], PLACES[1], PLACES[3]]
    assert found.is_complex == shape.is_complex()
    torch.testing.assert_close(found.shape, shape[:, [0, 2, 1, 3]], rtol=1e-5, atol=1e-7)
    torch.testing.assert_close(found.frequency, model.frequency, rtol=1e-5, atol=0)
    torch.testing.assert_close(found.damping_ratio, model.damping_ratio, rtol=1e-4, atol=0)


def test_pyuff_reads_what_is_written(tmp_path):
    path = tmp_path / "modes.uff"
    write_modal_model(made(), path)
    file = pyuff.UFF(str(path))
    first = file.read_sets(list(file.get_set_types()).index(55))
    assert first["freq"] == pytest.approx(41.237)
    assert first["r3"].tolist() == pytest.approx(REAL[0].tolist())
    assert first["r1"].tolist() == [0.0] * 4


@pytest.mark.parametrize("shape", [REAL, COMPLEX], ids=["real", "complex"])
def test_a_modal_model_comes_back_from_a_table_to_the_last_digit(tmp_path, shape):
    model, path = made(shape, (math.nan, 0.0127)), tmp_path / "modes.csv"
    write_modal_model(model, path)
    found = read_modal_model(path)
    assert torch.equal(found.shape, shape)
    assert torch.equal(found.frequency, model.frequency)
    assert found.damping_ratio.isnan().tolist() == [True, False]
    assert "nan" not in path.read_text()
    assert [one.coordinate for one in found.point] == list(PLACES)


def test_a_table_by_node_labels_may_come_with_semicolons(tmp_path):
    path = tmp_path / "modes.csv"
    path.write_text("mode;frequency_hz;damping_ratio;1;7w\n1;41.2;0.003;1.0;-0.5\n\n2;40.0;;0.2;1+0.1i\n")
    found = read_modal_model(path)
    assert [(one.node, one.coordinate) for one in found.point] == [(1, None), (7, None)]
    assert found.frequency.tolist() == [41.2, 40.0]
    assert found.shape[1, 1] == 1 + 0.1j


def test_modes_at_zero_are_left_out_and_said(tmp_path):
    path, model = tmp_path / "modes.uff", made()
    write_modal_model(replace(model, frequency=torch.tensor([1e-4, 93.5], dtype=torch.float64)), path)
    found = read_modal_model(path)
    assert found.frequency.tolist() == [93.5]
    assert "1 mode at 0 Hz" in found.notes[0]


def test_a_loss_factor_counts_as_half_of_it(tmp_path):
    path = tmp_path / "modes.uff"
    write_modal_model(made(damping=(0.0, 0.0127)), path)
    # Field 4 of record 8 of the first mode, in the columns of the format.
    written = path.read_text().replace(
        f"{41.237:13.5E}{0:13.5E}{0:13.5E}{0:13.5E}", f"{41.237:13.5E}{0:13.5E}{0:13.5E}{0.02:13.5E}"
    )
    path.write_text(written)
    assert read_modal_model(path).damping_ratio.tolist() == pytest.approx([0.01, 0.0127])


@pytest.mark.parametrize("data_type", [2, 5])
def test_a_dataset_2414_is_read(tmp_path, data_type):
    values = [(0.0, 0.0, value) for value in REAL[0].tolist()]
    lines = ["    -1", "  2414", f"{1:10d}", "mode", f"{1:10d}", *["NONE"] * 5]
    lines += ["".join(f"{x:10d}" for x in (1, 2, 2, 8, data_type, 3)), f"{0:10d}" * 8, f"{0:10d}" * 2]
    lines += ["".join(f"{x:13.5E}" for x in (0, 41.237, 0, 1, 0.0031, 0)), f"{0.0:13.5E}" * 6]
    for node, row in zip((3, 17, 8, 40), values, strict=True):
        parts = row if data_type == 2 else [part for value in row for part in (value, 0.1)]
        lines += [f"{node:10d}", "".join(f"{x:13.5E}" for x in parts)]
    path = tmp_path / "modes.unv"
    path.write_text("\n".join([*lines, "    -1", ""]))
    found = read_modal_model(path)
    assert (found.frequency.tolist(), found.damping_ratio.tolist()) == ([41.237], [0.0031])
    assert [one.node for one in found.point] == [3, 8, 17, 40]
    assert found.shape.real[0].tolist() == pytest.approx(REAL[0, [0, 2, 1, 3]].tolist())
    assert found.is_complex == (data_type == 5)


@pytest.mark.parametrize("pole", [(-0.8032, 259.1), (0.0, 0.0)], ids=["by its eigenvalue", "by its frequency alone"])
def test_a_complex_mode_of_a_dataset_2414_is_read_and_described(pole, tmp_path):
    lines = ["    -1", "  2414", f"{1:10d}", "mode", f"{1:10d}", *["NONE"] * 5]
    lines += ["".join(f"{x:10d}" for x in (1, 3, 2, 8, 5, 3)), f"{0:10d}" * 8, f"{0:10d}" * 2]
    lines += ["".join(f"{x:13.5E}" for x in (0, 41.237, 0, 1, 0.0031, 0))]
    lines += ["".join(f"{x:13.5E}" for x in (*pole, 0, 0, 0, 0))]
    for node, value in ((3, 1.0), (17, -0.5), (8, 0.25)):
        lines += [f"{node:10d}", "".join(f"{x:13.5E}" for x in (0, 0, 0, 0, value, 0.1))]
    path = tmp_path / "modes.unv"
    path.write_text("\n".join([*lines, "    -1", ""]))
    found = read_modal_model(path)
    assert found.frequency.tolist() == pytest.approx([41.237], rel=1e-4)
    assert found.damping_ratio.tolist() == pytest.approx([0.0031], rel=1e-3)
    assert found.is_complex
    (part,) = (one for one in describe(path).parts if "2414" in one.what)
    assert "41.237 Hz (0.31 %)" in part.detail
    assert "modal_model" in part.use


def test_a_file_of_rigid_body_modes_alone_is_refused(tmp_path):
    write_modal_model(made(), tmp_path / "modes.uff")
    text = (tmp_path / "modes.uff").read_text()
    for hertz in made().frequency.tolist():
        text = text.replace(f"{hertz:13.5E}", f"{0.0:13.5E}")
    (tmp_path / "modes.uff").write_text(text)
    with pytest.raises(MeasurementError, match="expected modes with a natural frequency, got 2 at 0 Hz"):
        read_modal_model(tmp_path / "modes.uff")


def test_a_file_of_another_maker_is_read(real_file):
    found = read_modal_model(real_file("uff/uff55_translation.uff"))
    assert found.frequency.tolist() == [10.0, 12.0, 13.0]
    assert found.shape[0].tolist() == pytest.approx([-1.46518, 0.150162, -0.376396, 0.724863])


def test_the_normal_may_be_another_axis(real_file):
    one, other = (read_modal_model(real_file("uff/uff55_translation.uff"), normal) for normal in (3, 1))
    assert torch.equal(one.shape, other.shape)  # that file has the same numbers along every axis


def test_modes_outside_a_band_are_left_out_and_said():
    kept = made().band(50.0, 100.0)
    assert kept.frequency.tolist() == [93.5]
    assert torch.equal(kept.shape, REAL[1:])
    assert "Left out 1 mode" in kept.notes[0]
    with pytest.raises(MeasurementError, match=r"from 41\.237 to 93\.5 Hz"):
        made().band(200.0, 300.0)


HEAD = "mode,frequency_hz,damping_ratio,1,2\n"
BAD = {
    "no head": ("1,41.2,0.003,1,2\n", "frequency_hz"),
    "no shapes": ("mode,frequency_hz,damping_ratio\n1,41,0\n", "natural_frequencies"),
    "no mode": (HEAD, "a line for each mode"),
    "nothing": ("", "an empty file"),
    "a cell short": (HEAD + "1,41.2,0.003,1\n", "5 cells"),
    "a word": (HEAD + "1,41.2,0.003,up,1\n", "'up'"),
    "no frequency": (HEAD + "1,,0.003,1,1\n", "frequency_hz"),
    "a negative frequency": (HEAD + "1,-4,0.003,1,1\n", "-4 for mode 1"),
    "a shape of zeros": (HEAD + "1,41,0.003,0,0\n", "zero everywhere"),
    "a point twice": ("mode,frequency_hz,damping_ratio,1,1\n1,41,0,1,2\n", "each point once"),
    "a place of three": ('mode,frequency_hz,damping_ratio,"1,2,3"\n1,41,0,1\n', "'1,2,3'"),
    "a negative damping": (HEAD + "1,41,-0.1,1,1\n", "-0.1 for mode 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_table_gets_one_sentence_with_its_file(tmp_path, name):
    text, word = BAD[name]
    path = tmp_path / "modes.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError) as told:
        read_modal_model(path)
    assert str(told.value).startswith(f"{path}: expected")
    assert word in str(told.value)


def test_a_file_without_modes_is_refused_with_the_way_on(tmp_path, real_file):
    with pytest.raises(MeasurementError, match=r"torchplate modes Sample_UFF58_ascii\.uff"):
        read_modal_model(real_file("uff/Sample_UFF58_ascii.uff"))
    with pytest.raises(MeasurementError, match="no file there"):
        read_modal_model(tmp_path / "absent.uff")
    with pytest.raises(MeasurementError, match=r"'\.xls'"):
        read_modal_model(tmp_path / "modes.xls")
