"""Places and directions in a universal file's own coordinate systems come out in the global one, as by hand."""

import numpy as np
import pytest
import torch

from torchplate.measurement import MeasurementError, read_geometry, read_measurement, read_modal_model

# Dataset 18: number, kind, reference system, origin, a point on +x, a point in the +xz plane, in the reference system.
# Of 7 the axes are x = ŷ, y = −ẑ, z = −x̂; 8 lies in 7, one along its z.
BY_POINTS = [
    (8, 1, 7, (0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 0.0, 2.0)),
    (7, 0, 0, (1.0, 2.0, 0.5), (1.0, 3.0, 0.5), (0.0, 2.0, 0.5)),
]
# Dataset 2420: number, kind, rows of the matrix; the last is the origin.
BY_MATRIX = [
    (5, 0, [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.1, 0.2, 0.3)]),
    (6, 2, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)]),
    # Turned by half about x, as some analysers turn every node: +z points to the floor.
    (9, 0, [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)]),
    # Its x is ẑ, tilted by 20 degrees.
    (4, 0, [
        (np.sin(np.radians(20)), 0.0, np.cos(np.radians(20))), (0.0, 1.0, 0.0),
        (-np.cos(np.radians(20)), 0.0, np.sin(np.radians(20))), (0.0, 0.0, 0.0),
    ]),
]  # fmt: skip


def numbers(values, width=13, digits=5):
    return "".join(f"{value:{width}.{digits}E}" for value in values)


def dataset_18(rows):
    lines = ["    -1", "    18"]
    for number, kind, reference, origin, along, beside in rows:
        lines += [f"{number:10d}{kind:10d}{reference:10d}{8:10d}{1:10d}", f"SYS{number}"]
        lines += [numbers((*origin, *along)), numbers(beside)]
    return "\n".join([*lines, "    -1\n"]).encode()


def dataset_2420(rows):
    lines = ["    -1", "  2420", f"{1:10d}", "a part"]
    for number, kind, matrix in rows:
        lines += [f"{number:10d}{kind:10d}{8:10d}", f"CS{number}", *(numbers(row, 25, 16) for row in matrix)]
    return "\n".join([*lines, "    -1\n"]).encode()


def dataset_2411(rows):
    lines = ["    -1", "  2411"]
    for node, of_place, of_direction, *place in rows:
        lines += [f"{node:10d}{of_place:10d}{of_direction:10d}{11:10d}", numbers(place, 25, 16)]
    return "\n".join([*lines, "    -1\n"]).encode()


def dataset_15(rows):
    lines = ["    -1", "    15"]
    lines += [f"{node:10d}{own:10d}{way:10d}{8:10d}{numbers(place)}" for node, own, way, *place in rows]
    return "\n".join([*lines, "    -1\n"]).encode()


def dataset_164(length):
    factors = numbers((length, 1.0, 1.0), 25, 16), numbers((0.0,), 25, 16)
    return "\n".join(["    -1", "   164", f"{9:10d}{'own':20s}{0:10d}", *factors, "    -1\n"]).encode()


SYSTEMS = {18: dataset_18(BY_POINTS), 2420: dataset_2420(BY_MATRIX)}
VALUES = np.array([1.5 - 2.25j, -0.125 + 8.0j, 3.0 + 0.5j, 1e-3 - 4e-4j])


def values():
    cells = [f"{part:13.5E}" for value in VALUES for part in (value.real, value.imag)]
    return ["".join(cells[:6]), "".join(cells[6:])]


@pytest.mark.parametrize("nodes", [dataset_15, dataset_2411])
@pytest.mark.parametrize(
    ("kind", "number", "own", "by_hand"),
    [
        (18, 7, (0.3, 0.1, 0.2), (0.8, 2.3, 0.4)),
        # Cylindrical: 0.5 at 90 degrees is 0.5 along its y, which is −ẑ; 0.25 along its z, which is −x̂.
        (18, 8, (0.5, 90.0, 0.25), (-0.25, 2.0, 0.0)),
        (2420, 5, (1.0, 2.0, 3.0), (2.1, 3.2, 1.3)),
        # Spherical: r, θ from z, φ.
        (2420, 6, (2.0, 30.0, 90.0), (0.0, 1.0, 3**0.5)),
    ],
)
def test_places_are_those_by_hand(kind, number, own, by_hand, nodes, tmp_path):
    path = tmp_path / "systems.uff"
    table = nodes([(4, number, 0, *own), (9, 0, 0, 0.25, 0.5, 0.125)])
    # Where the nodes stand in the file, and the systems after them, does not matter; the length is in the file's unit.
    path.write_bytes(dataset_164(1000.0) + table + SYSTEMS[kind])
    places, _ = read_geometry(path)
    np.testing.assert_allclose(1000 * np.array(places[4]), by_hand, atol=1e-5)
    np.testing.assert_allclose(1000 * np.array(places[9]), (0.25, 0.5, 0.125), atol=1e-12)


def test_a_measurement_says_which_places_were_turned(record_58, tmp_path):
    path = tmp_path / "systems.uff"
    table = dataset_2411([(4, 5, 0, 1.0, 2.0, 3.0), (9, 0, 0, 0.25, 0.5, 0.125)])
    path.write_bytes(SYSTEMS[2420] + table + record_58(values(), n_point=4, ordinate_type=5))
    found = read_measurement(path)
    assert found.response[0].coordinate == pytest.approx((2.1, 3.2, 1.3))
    assert "The places of 1 node were turned into the global coordinate system, from 5" in found.notes[0]


@pytest.mark.parametrize(
    ("way", "direction", "sign", "said"),
    [
        (0, 3, 1, None),
        (9, 3, -1, "The directions of 1 FRF were turned"),
        (9, -3, 1, "The directions of 1 FRF were turned"),
        # z of system 5 is the global y, its x the global z.
        (5, 1, 1, "The directions of 1 FRF were turned"),
        (4, 1, 1, "is turned by 20 degrees from the nearest axis"),
    ],
)
def test_a_sensor_points_where_its_own_system_says(way, direction, sign, said, record_58, tmp_path):
    path = tmp_path / "ways.uff"
    table = dataset_2411([(4, 0, way, 0.1, 0.2, 0.0), (9, 0, 0, 0.25, 0.5, 0.0)])
    record = record_58(values(), n_point=4, ordinate_type=5, response=(4, direction))
    path.write_bytes(SYSTEMS[2420] + table + record)
    found = read_measurement(path)
    np.testing.assert_allclose(found.frf[:, 0, 0].numpy(), sign * VALUES, rtol=5e-6)
    assert (said is None and not found.notes) or any(said in note for note in found.notes)


def test_a_sensor_whose_system_lays_it_in_the_plane_is_left_out(record_58, tmp_path):
    path = tmp_path / "ways.uff"
    table = dataset_2411([(4, 0, 5, 0.1, 0.2, 0.0), (9, 0, 0, 0.25, 0.5, 0.0)])
    two = [record_58(values(), n_point=4, ordinate_type=5, response=(4, direction)) for direction in (1, 3)]
    path.write_bytes(SYSTEMS[2420] + table + b"".join(two))
    found = read_measurement(path)
    assert found.frf.shape == (4, 1, 1)
    assert any(note.startswith("Left out 1 FRF that is not out of the plate") for note in found.notes)


def test_the_axis_of_the_sensors_is_a_global_one(record_58, tmp_path):
    path = tmp_path / "ways.uff"
    table = dataset_2411([(4, 0, 5, 0.1, 0.2, 0.0), (9, 0, 5, 0.25, 0.5, 0.0)])
    path.write_bytes(SYSTEMS[2420] + table + record_58(values(), n_point=4, ordinate_type=5, response=(4, 3)))
    assert read_geometry(path)[1] == 2


def test_a_direction_along_the_radius_depends_on_the_place(record_58, tmp_path):
    # Cylinder about the global z: at 180 degrees the radius points along −x.
    cylinder = dataset_2420([(3, 1, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])])
    path = tmp_path / "cylinder.uff"
    table = dataset_2411([(4, 3, 3, 0.2, 180.0, 0.0), (9, 3, 3, 0.3, 90.0, 0.0)])
    record = record_58(values(), n_point=4, ordinate_type=5, response=(4, 1), reference=(4, 1))
    path.write_bytes(cylinder + table + record)
    places, axis = read_geometry(path)
    assert axis == 1
    np.testing.assert_allclose([places[4], places[9]], [(-0.2, 0, 0), (0, 0.3, 0)], atol=1e-12)
    np.testing.assert_allclose(read_measurement(path, normal=1).frf[:, 0, 0].numpy(), VALUES, rtol=5e-6)


def test_mode_shapes_are_turned_with_their_nodes(tmp_path):
    path = tmp_path / "modes.uff"
    table = dataset_2411([(1, 0, 0, 0.0, 0.0, 0.0), (2, 0, 9, 0.3, 0.0, 0.0), (3, 0, 5, 0.0, 0.2, 0.0)])
    lines = ["    -1", "    55", *["NONE"] * 5, "".join(f"{value:10d}" for value in (1, 2, 2, 8, 2, 3))]
    lines += ["".join(f"{value:10d}" for value in (2, 4, 1, 1)), numbers((41.0, 0.0, 0.01, 0.0))]
    for node in (1, 2, 3):
        lines += [f"{node:10d}", numbers((0.5, 0.25, 2.0))]
    path.write_bytes(SYSTEMS[2420] + table + "\n".join([*lines, "    -1\n"]).encode())
    # Node 2's z is −ẑ; of node 3 only x is out of the plate.
    assert torch.equal(read_modal_model(path).shape, torch.tensor([[2.0, -2.0, 0.5]], dtype=torch.float64))


def test_systems_that_the_file_does_not_define_are_named(record_58, tmp_path):
    path = tmp_path / "strange.uff"
    table = dataset_15([(4, 31, 0, 0.1, 0.2, 0.0), (9, 1, 1, 0.25, 0.5, 0.0)])
    path.write_bytes(table + record_58(values(), n_point=4, ordinate_type=5))
    (note,) = read_measurement(path).notes
    assert note.startswith("The file gives 1 node in coordinate systems that it does not define (31)")


def test_a_system_that_is_called_1_is_applied_where_it_is_defined(tmp_path):
    path = tmp_path / "one.uff"
    rows = [(1, 0, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, 0.0)])]
    path.write_bytes(dataset_2420(rows) + dataset_15([(4, 1, 1, 0.1, 0.2, 0.0)]))
    assert read_geometry(path)[0][4] == pytest.approx((0.6, 0.2, 0.0))


@pytest.mark.parametrize(
    "systems",
    [
        dataset_18([(7, 0, 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))]),
        dataset_18([(7, 0, 7, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))]),
        dataset_2420([(7, 0, [(2.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])]),
        dataset_2420([(7, 5, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])]),
    ],
    ids=["no axis", "in itself", "stretched", "of no kind"],
)
def test_a_system_that_cannot_be_is_refused_where_a_node_is_in_it(systems, tmp_path):
    path = tmp_path / "broken.uff"
    path.write_bytes(systems + dataset_15([(4, 0, 0, 0.1, 0.2, 0.0)]))
    assert read_geometry(path)[0][4] == pytest.approx((0.1, 0.2, 0.0))
    path.write_bytes(systems + dataset_15([(4, 7, 0, 0.1, 0.2, 0.0)]))
    with pytest.raises(MeasurementError, match=r"broken\.uff: expected coordinate system 7 of node 4"):
        read_geometry(path)
