"""Channels are put where their coordinates or node numbers say, and nowhere else."""

from dataclasses import replace

import pytest
import torch

from torchplate.measurement import Channel, MeasurementError, place


@pytest.mark.parametrize(
    ("node", "where"),
    [(1, (0.0, 0.0)), (11, (1.0, 0.0)), (12, (0.0, 0.1)), (36, (0.2, 0.3)), (121, (1.0, 1.0))],
)
def test_nodes_count_along_x_first_on_the_10_by_10_mesh(node, where, make_measurement):
    measurement = replace(make_measurement(responses=(3,), coordinates=False), response=(Channel(node),))
    found = place(measurement, 0.48, 0.48, 10, 10)
    assert found.by == "node"
    assert found.response[0].place == pytest.approx(where)
    assert (found.response[0].nearest_node, found.response[0].distance) == (node, 0.0)


def test_a_grid_that_is_not_square_counts_its_own_row_length(make_measurement):
    found = place(make_measurement(coordinates=False), 0.3, 0.2, 6, 4)
    # Node 17 on rows of seven: third of the third row. Node 8 opens the second.
    torch.testing.assert_close(
        found.reference_place,
        torch.tensor([[2 / 6, 2 / 4], [2 / 6, 0.0], [0.0, 1 / 4]], dtype=torch.float64),
    )
    torch.testing.assert_close(found.response_place[1], found.reference_place[0])


def test_coordinates_win_over_node_numbers_and_report_their_distance(make_measurement):
    found = place(make_measurement(), 0.3, 0.2, 6, 4)
    assert found.by == "coordinate"
    match = found.reference[2]
    assert match.label == "8w"
    # (0.233, 0.07) m: the nearest node is (0.25, 0.05), column 5 of row 1, 17 mm and 20 mm away.
    assert match.place == pytest.approx((0.233 / 0.3, 0.07 / 0.2), rel=1e-14)
    assert match.nearest_node == 1 * 7 + 5 + 1
    assert match.distance == pytest.approx((0.017**2 + 0.02**2) ** 0.5)
    assert match.outside == 0.0


def with_response_at(make_measurement, x: float, y: float):
    return replace(make_measurement(responses=(3,)), response=(Channel(3, "w", (x, y, 0.0)),))


def test_a_channel_a_little_off_the_plate_goes_to_its_edge_and_says_how_far(make_measurement):
    match = place(with_response_at(make_measurement, 0.302, -0.001), 0.3, 0.2, 6, 4).response[0]
    assert match.place == (1.0, 0.0)
    assert match.nearest_node == 7
    assert match.outside == pytest.approx((0.002**2 + 0.001**2) ** 0.5)
    assert match.distance == pytest.approx(match.outside)


@pytest.mark.parametrize(
    ("x", "y", "word"),
    [
        (0.3040, 0.1, "0.004 m off"),
        (0.1, -0.0035, "mesh.length_x"),
        (150.0, 100.0, "millimetres"),
        (float("nan"), 0.1, "3w"),
        (0.1, -1e200, "m off it"),
    ],
)
def test_a_channel_off_the_plate_is_an_error_that_names_it(x, y, word, make_measurement):
    with pytest.raises(MeasurementError, match="3w on the plate") as caught:
        place(with_response_at(make_measurement, x, y), 0.3, 0.2, 6, 4)
    assert word in str(caught.value)


@pytest.mark.parametrize("node", [0, 36])
def test_a_node_number_beyond_the_grid_is_an_error(node, make_measurement):
    measurement = replace(make_measurement(responses=(3,), coordinates=False), response=(Channel(node),))
    with pytest.raises(MeasurementError, match=f"1 to 35 on the 6 × 4 mesh, got {node}w"):
        place(measurement, 0.3, 0.2, 6, 4)


def test_coordinates_for_some_channels_only_are_an_error(make_measurement):
    measurement = replace(make_measurement(responses=(3,)), response=(Channel(3),))
    with pytest.raises(MeasurementError, match="none for 3w"):
        place(measurement, 0.3, 0.2, 6, 4)


def test_an_in_plane_channel_is_an_error(make_measurement):
    measurement = replace(make_measurement(responses=(3,)), response=(Channel(3, "u", (0.1, 0.1, 0.0)),))
    with pytest.raises(MeasurementError, match="3u"):
        place(measurement, 0.3, 0.2, 6, 4)


def test_a_transmissibility_has_no_reference_place(make_measurement):
    far_base = (Channel(99, "w", (-5.0, 0.0, 0.0)),)
    measurement = replace(make_measurement(kind="transmissibility", references=(8,)), reference=far_base)
    found = place(measurement, 0.3, 0.2, 6, 4)
    assert len(found.response) == 2
    assert found.reference == ()
    assert found.reference_place.shape == (0, 2)


def test_a_match_by_number_says_that_it_is_a_guess_and_where_it_puts_the_nodes(make_measurement):
    remark = place(make_measurement(coordinates=False), 0.3, 0.2, 6, 4).remark
    # Nodes 3, 17 and 8 of rows of seven: columns 2, 2 and 0 of rows 0, 2 and 1.
    for words in ("2 responses and 3 references", "node number", "3 to 17", "x 0 to 0.1 m, y 0 to 0.1 m", "2411"):
        assert words in remark


def test_a_match_by_coordinates_says_so_and_names_the_channel_that_is_off_the_plate(make_measurement):
    assert place(make_measurement(), 0.3, 0.2, 6, 4).remark == (
        "Matched 2 responses and 3 references to the plate by their coordinates."
    )
    off = place(with_response_at(make_measurement, 0.302, 0.1), 0.3, 0.2, 6, 4).remark
    assert "1 response " in off
    assert "3w lies 2 mm off the plate" in off
