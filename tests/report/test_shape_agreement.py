"""MAC, AutoMAC and COMAC of measured mode shapes as a reader sees them."""

import pytest
import torch

from torchplate.discrepancy import ModalEvidence, comac, mac
from torchplate.effects import Plate
from torchplate.measurement import Channel, ModalModel
from torchplate.model import PlateModel, modes_at
from torchplate.plate import Mesh
from torchplate.report.figures.drawing import svg
from torchplate.report.figures.modal_fdac import fdac_figure, modal_fdac
from torchplate.report.figures.paired_shapes import shapes_of
from torchplate.report.figures.shape_agreement import agreement, comac_figure, mac_figure

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


@pytest.mark.check
def test_the_pictures_are_drawn_for_a_page_and_say_what_they_show(shapes):
    found = agreement(shapes)
    assert list(found) == ["mac", "comac", "fdac"]
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
    found = agreement(alone)
    assert "one measured mode" in found["mac"][0].told
    # At every frequency it is the same shape: there is nothing to compare between lines.
    assert "fdac" not in found


def test_each_value_of_the_fdac_is_the_likeness_of_two_operating_shapes(shapes):
    low = shapes._replace(model_hertz=tuple(0.94 * f for f in shapes.hertz), damping_ratio=(0.004,) * 6)
    found = modal_fdac(low)
    row, column = 31, 140
    scaled = shapes.measured * (shapes.measured * shapes.model).sum(-1, keepdim=True)
    scaled = scaled / shapes.measured.square().sum(-1, keepdim=True)
    operating = []
    for shape, hertzs, line in ((shapes.model, low.model_hertz, row), (scaled, low.hertz, column)):
        f = float(found.frequency[line])
        parts = [
            s[found.point] * s / complex(f_r**2 - f**2, 2 * 0.004 * f_r * f)
            for s, f_r in zip(shape.numpy(), hertzs, strict=True)
        ]
        operating.append(sum(parts))
    a, e = operating
    expected = abs((a.conj() * e).sum()) ** 2 / ((abs(a) ** 2).sum() * (abs(e) ** 2).sum())
    # Sums of six terms in float64, in another order.
    assert float(found.value[row, column]) == pytest.approx(expected, rel=1e-9)
    assert float(found.frequency[0]) == pytest.approx(0.9 * 0.94 * low.hertz[0])
    assert float(found.frequency[-1]) == pytest.approx(1.1 * low.hertz[-1])


def test_a_model_that_is_too_soft_has_its_ridge_below_the_diagonal(shapes):
    low = shapes._replace(model_hertz=tuple(0.94 * f for f in shapes.hertz))
    criterion = modal_fdac(low)
    line = criterion.frequency
    for hertz in low.hertz:
        measured, model, same = (int((line - f).abs().argmin()) for f in (hertz, 0.94 * hertz, hertz))
        assert float(criterion.value[model, measured]) > 0.55
        assert model < same
    mesh = next(one for one in fdac_figure(criterion).axes[0].collections if one.get_array() is not None)
    torch.testing.assert_close(torch.as_tensor(mesh.get_array().data), criterion.value)
    assert "a force at" in agreement(low)["fdac"][0].caption
    assert "0.01 where no damping was measured" in agreement(low)["fdac"][0].caption


def test_a_model_with_the_measured_modes_has_a_ridge_of_ones(model):
    places = model.mesh.places(NODES)
    true = modes_at(model, model.known.new_zeros(0), places, 10)
    ratio = torch.full((6,), 0.01).double()
    modal = ModalModel(true.frequency[3:9], ratio, true.shape[3:9], tuple(map(Channel, NODES)))
    criterion = modal_fdac(shapes_of(ModalEvidence.of(model, modal), model, model.known.new_zeros(0)))
    torch.testing.assert_close(criterion.value.diagonal(), torch.ones(200).double(), rtol=0, atol=1e-9)


def test_a_point_without_a_node_is_called_by_its_place(model):
    places = model.mesh.places(NODES)
    true = modes_at(model, model.known.new_zeros(0), places, 10)
    points = tuple(Channel(0, "w", (0.41 * x, 0.29 * y, 0.0)) for x, y in places.tolist())
    modal = ModalModel(true.frequency[3:9], torch.full((6,), 0.01).double(), true.shape[3:9], points)
    found = shapes_of(ModalEvidence.of(model, modal), model, model.known.new_zeros(0))
    assert found.label[1] == "(0.137, 0)"
    assert all(text.get_text() == "1.00" for text in comac_figure(found).axes[0].texts)
    assert "0w" not in agreement(found)["fdac"][0].caption + agreement(found)["comac"][0].told
