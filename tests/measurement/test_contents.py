"""Every dataset of a universal file is described, with what can be done with it; none stops the description."""

from pathlib import Path

import numpy as np
import pytest
import pyuff

from torchplate.measurement import MeasurementError, describe, write_uff

SAMPLES = Path(__file__).parents[2].parent / "shared" / "data" / "uff"


def words(path: Path) -> str:
    found = describe(path)
    assert all(all(part) for part in found.parts)
    return "\n".join(" | ".join(part) for part in found.parts)


EXPECTED = {
    "Sample_UFF58_ascii.uff": ("time response", "79292 values", "65536 Hz", "sound pressure [Pa]", "not used"),
    "Sample_UFF58b_bin.uff": ("time response", "79292 values", "sound pressure [Pa]"),
    "TestLab 161 164 18 15 82.uff": (
        "LMS Test.Lab", "its own units", "36 coordinate systems", "36 nodes, labels 1 to 36, x -2.6 to 2.6",
        "not in one plane", "trace lines", "--nodes 'TestLab 161 164 18 15 82.uff'",
    ),
    "binary8byte.uff": ("time response", "100 Hz", "acceleration [g]", "torchplate frf binary8byte.uff FORCE.uff"),
    "groups_test.uff": ("m, N", "74 nodes", "z 0 to 50", "144 triangles", "149 tetrahedra", "groups"),
    "mesh_Oros-modal_uff15_uff2412.uff": ("96 nodes", "72 quads", "CS1"),
    "non_ascii_header.uff": ("frequency response function", "6 values, 0 to 0.976565 Hz", "--kind accelerance --nodes"),
    "sample_dataset58_psd.uff": ("power spectral density", "3201 values, 0 to 3200 Hz, step 1,", "natural_frequencies"),
    "time-history-not-all-columns-filled.uff": ("time response", "20000 Hz", "m/s²"),
    "uff55_translation.uff": ("3 of a normal mode", "10 Hz, 12 Hz, 13 Hz", "{modal_model: {file: uff55"),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPECTED)
def test_the_sample_files_are_described(name):
    if not SAMPLES.is_dir():
        pytest.skip(f"{SAMPLES} is absent: the sample files are not part of the project")
    assert {path.name for path in SAMPLES.glob("*.uff")} == set(EXPECTED)
    text = words(SAMPLES / name)
    for word in EXPECTED[name]:
        assert word in text


def test_frfs_and_their_geometry_name_the_command(tmp_path, make_measurement):
    path = tmp_path / "plate.uff"
    write_uff(make_measurement(coherence=True), path)
    text = words(path)
    for word in (
        "units: code 1 (m, N), 1 lengths per metre",
        "geometry: 3 nodes, labels 3 to 17, x 0.05 to 0.233, y 0.02 to 0.19, z 0 to 0.001",
        "6 × frequency response function",
        "acceleration over excitation force [m/s2], channels 3z/17z",
        "6 × coherence",
        "torchplate new plate.uff",
    ):
        assert word in text
    assert describe(path).has_frf
    assert not describe(path).has_time


ONE = """
    -1
    18
         7         0         0         8         1
SYS7
  0.00000E+00  0.00000E+00  0.00000E+00  1.00000E+00  0.00000E+00  0.00000E+00
  0.00000E+00  0.00000E+00  1.00000E+00
    -1
    -1
  2411
         4         7         0        11
   1.0000000000000000E-01   2.0000000000000000E-01   0.0000000000000000E+00
    -1
    -1
  2412
         1        94         1         1         7         4
         1         2         3         4
         2       111         1         1         7         4
         1         2         3         5
    -1
"""


def test_one_of_a_kind_is_no_plural(tmp_path):
    (tmp_path / "one.uff").write_text(ONE[1:])
    text = words(tmp_path / "one.uff")
    assert "1 coordinate system: SYS7" in text
    assert "geometry: 1 node, labels 4 to 4" in text
    assert "as stated in 1 coordinate system of their own" in text
    assert "elements: 1 quad, 1 tetrahedron |" in text


@pytest.mark.parametrize("unit", ["Hz", "NONE"])
@pytest.mark.parametrize(
    ("line", "text"), [([0, 2, 4, 6], "4 values, 0 to 6 Hz, step 2,"), ([0, 2, 4, 7], "0 to 7 Hz, uneven spacing,")]
)
def test_lines_that_are_written_one_by_one_are_described_by_their_values(line, text, unit, tmp_path):
    """In Hz, too, where the file says frequencies and no unit."""
    path = tmp_path / "frf.uff"
    pyuff.UFF(str(path)).write_sets(
        {
            "type": 58, "func_type": 4, "rsp_node": 1, "rsp_dir": 3, "ref_node": 2, "ref_dir": 3, "id1": "NONE",
            "x": np.array(line, dtype=float), "data": np.ones(4) + 1j, "binary": 0, "abscissa_spacing": 0,
            "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "abscissa_axis_units_lab": unit,
            "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13,
        },
        "add",
    )  # fmt: skip
    assert text in words(path)


def test_modes_with_damping_are_listed_in_rising_order(tmp_path):
    path = tmp_path / "modes.uff"
    file = pyuff.UFF(str(path))
    for n, f in ((1, 93.0), (2, 41.5)):
        file.write_sets(
            {
                "type": 55, "model_type": 1, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8, "load_case": 0,
                "mode_n": n, "freq": f, "modal_damp_vis": 0.004, "node_nums": np.array([1, 2]),
                "r1": np.zeros(2), "r2": np.zeros(2), "r3": np.ones(2),
            },
            "add",
        )  # fmt: skip
    assert "41.5 Hz (0.4 %), 93 Hz (0.4 %)" in words(path)


def test_complex_modes_give_frequency_and_damping(tmp_path):
    path = tmp_path / "modes.uff"
    pole = 2 * np.pi * 50 * complex(-0.02, np.sqrt(1 - 0.02**2))
    pyuff.UFF(str(path)).write_sets(
        {
            "type": 55, "model_type": 1, "analysis_type": 3, "data_ch": 2, "spec_data_type": 8, "load_case": 0,
            "mode_n": 1, "eig": pole, "modal_a": 0j, "modal_b": 0j, "node_nums": np.array([1, 2]),
            "r1": np.zeros(2) + 0j, "r2": np.zeros(2) + 0j, "r3": np.ones(2) + 1j,
        },
        "add",
    )  # fmt: skip
    assert "50 Hz (2 %)" in words(path)


def test_a_dataset_that_does_not_parse_or_is_unknown_is_said_to_be_so(tmp_path):
    path = tmp_path / "odd.uff"
    path.write_bytes(b"    -1\n  2411\n  one two\n    -1\n    -1\n 99999\nwhatever\n    -1\n    -1\n    58\n    -1\n")
    text = words(path)
    assert "dataset 2411 | does not parse" in text
    assert "99999 | of a kind" in text
    assert "header does not parse" in text


def test_nodes_beside_a_record_that_does_not_parse_are_described(tmp_path):
    path = tmp_path / "odd.uff"
    node = f"{7:10d}{0:10d}{0:10d}{8:10d}{0.1:13.5E}{0.2:13.5E}{0.0:13.5E}\n"
    path.write_bytes(f"    -1\n    15\n{node}    -1\n    -1\n    58\n    -1\n".encode())
    text = words(path)
    assert "header does not parse" in text
    assert "geometry: 1 node, labels 7 to 7" in text


@pytest.mark.parametrize("content", [b"", b"nothing", b"    -1\n    58\n", bytes(range(256)) * 20])
def test_what_is_no_universal_file_is_refused(content, tmp_path):
    (tmp_path / "odd.uff").write_bytes(content)
    with pytest.raises(MeasurementError, match=r"odd\.uff"):
        describe(tmp_path / "odd.uff")
