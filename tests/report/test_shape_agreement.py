"""MAC, AutoMAC and COMAC of measured mode shapes as a reader sees them."""

import pytest
import torch

from torchplate.discrepancy import ModalEvidence, comac, mac
from torchplate.effects import Plate
from torchplate.measurement import Channel, ModalModel
from torchplate.model import PlateModel, modes_at
from torchplate.plate import Mesh
from torchplate.report.drawing import svg
from torchplate.report.shape_agreement import agreement, comac_figure, mac_figure, shapes_of

NODES = [1, 3, 5, 11, 13, 15, 17, 19, 21, 23, 25, 29, 31, 33, 35]
WRONG = 4
"""Index of the point, node 13, whose sensor sits elsewhere."""


@pytest.fixture(scope="module")
def model():
    known = {
        "plate.youngs_modulus": 2.04e11,
        "plate.poisson_ratio": 0.3,
        "plate.density": 7860.0,
        "plate.thickness": 0.003,
    }
    return PlateModel(Mesh(0.41, 0.29, 6, 4), {"plate": Plate()}, known, {})


@pytest.fixture(scope="module")
def shapes(model):
    """Six modes in no order; the sensor of one point sits a third of the plate away."""
    order = [7, 3, 5, 4, 8, 6]
    true = modes_at(model, model.known.new_zeros(0), model.mesh.places(NODES), 12)
    shape = true.shape[order].clone()
    elsewhere = modes_at(model, model.known.new_zeros(0), torch.tensor([[0.5, 0.5]], dtype=torch.float64), 12)
    shape[:, WRONG] = elsewhere.shape[order, 0]
    unknown = torch.full((6,), torch.nan, dtype=shape.dtype)
    modal = ModalModel(true.frequency[order], unknown, shape, tuple(Channel(node) for node in NODES))
    return shapes_of(ModalEvidence.of(model, modal), model, model.known.new_zeros(0))


def test_modes_stand_in_the_order_of_their_frequencies_each_beside_its_own(shapes):
    assert list(shapes.hertz) == sorted(shapes.hertz)
    assert shapes.number == (4, 5, 6, 7, 8, 9)
    assert shapes.sides == (0.41, 0.29)
    torch.testing.assert_close(shapes.between, mac(shapes.measured, shapes.model))
    assert float(shapes.between.diagonal().min()) > 0.6


def test_the_point_whose_sensor_sits_elsewhere_has_the_least_comac_and_is_named(shapes):
    value = comac(shapes.measured, shapes.model)
    least = float(value[WRONG])
    assert least < 0.8
    assert f"least at 13w {least:.2f}" in agreement(shapes)["comac"][0].told
    texts = [text.get_text() for text in comac_figure(shapes).axes[0].texts]
    assert texts[0] == f"13w: {least:.2f}"


def test_the_squares_hold_the_numbers_of_every_pair(shapes):
    between, among = (axis for axis in mac_figure(shapes).axes if axis.get_title(loc="left"))
    for axis, value in ((between, shapes.between), (among, shapes.among)):
        assert [one.get_text() for one in axis.texts] == [f"{float(one):.2f}" for one in value.flatten()]
    assert [tick.get_text() for tick in between.get_xticklabels()] == ["4", "5", "6", "7", "8", "9"]


def test_two_shapes_that_the_points_do_not_part_are_said(model, shapes):
    alike = shapes.measured.clone()
    alike[1] = alike[0]
    told = agreement(shapes._replace(measured=alike))["mac"][0].told
    pair = f"{shapes.hertz[0]:.4g} and {shapes.hertz[1]:.4g} Hz"
    assert f"up to 1.00, of {pair}: these points hardly tell the two apart" in told
    assert "the points tell them apart" not in told


def test_the_pictures_are_drawn_for_a_page_and_say_what_they_show(shapes):
    found = agreement(shapes)
    assert list(found) == ["mac", "comac"]
    for name, (picture, figure) in found.items():
        assert picture.name == name
        assert figure.axes
        for panel in picture.panels:
            drawn = svg(panel.draw(), name, panel.told)
            assert "<svg" in drawn
            assert panel.told[:20] in drawn


def test_a_single_mode_has_no_other_to_be_told_from(shapes):
    alone = shapes._replace(
        number=shapes.number[:1], hertz=shapes.hertz[:1], measured=shapes.measured[:1], model=shapes.model[:1]
    )
    assert "one measured mode" in agreement(alone)["mac"][0].told
