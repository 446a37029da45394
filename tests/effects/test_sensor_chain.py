"""What the sensor chain does to readings: late, too loud, elsewhere, upside down, exchanged."""

import math

import pytest
import torch

from torchplate.effects import (
    AspectRatio,
    ChannelPolarity,
    ChannelSwap,
    Effect,
    ExponentialWindow,
    HystereticDamping,
    Plate,
    SensorGain,
    SensorPosition,
    TimeDelay,
)
from torchplate.model import PlateModel
from torchplate.plate import Mesh

KNOWN = {
    "plate.youngs_modulus": 70e9,
    "plate.poisson_ratio": 0.33,
    "plate.density": 2700.0,
    "plate.thickness": 0.003,
    "loss.stiffness_loss_factor": 0.02,
}
NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.tensor([13.0, 63.0, 154.0, 310.0], dtype=torch.float64)
MESHES = {"rectangle": Mesh(0.5, 0.3, 6, 4), "square": Mesh(0.4, 0.4, 5, 5, edges={"x1": "clamped"})}
RESPONSE, REFERENCE = [3, 8, (0.61, 0.72)], [9, 3]


@pytest.fixture(params=list(MESHES))
def mesh(request: pytest.FixtureRequest) -> Mesh:
    return MESHES[request.param]


def _model(mesh: Mesh, effects: dict[str, Effect] | None = None, **value: float) -> PlateModel:
    """Values by `label_parameter`; the plate's stay."""
    known = KNOWN | {name.replace("_", ".", 1): number for name, number in value.items()}
    return PlateModel(mesh, {"plate": Plate(), "loss": HystereticDamping(), **(effects or {})}, known)


def _frf(model: PlateModel, response=RESPONSE, reference=REFERENCE, kind="accelerance") -> torch.Tensor:
    return model.frf(NONE, LINES, response, reference, kind)


def test_a_delay_turns_the_phase_by_the_same_slope_everywhere(mesh):
    delay = 2.7e-4
    ratio = _frf(_model(mesh, {"late": TimeDelay()}, late_delay=delay)) / _frf(_model(mesh))
    expected = torch.polar(torch.ones(4).double(), -2 * math.pi * LINES * delay)[:, None, None].expand_as(ratio)
    assert torch.allclose(ratio, expected, rtol=1e-12)


def test_a_delayed_record_is_windowed_after_it_was_delayed(mesh):
    both = {"late": TimeDelay(), "window": ExponentialWindow()}
    found = [
        _frf(_model(mesh, dict(order), late_delay=3e-3, window_rate=20.0))
        for order in (both.items(), reversed(both.items()))
    ]
    assert torch.equal(*found)
    # y(t − τ) exp(−σt) = exp(−στ) · y(t − τ) exp(−σ (t − τ)).
    plain = _frf(_model(mesh, {"window": ExponentialWindow()}, window_rate=20.0))
    expected = plain * torch.exp(-(20.0 + 2j * math.pi * LINES) * 3e-3)[:, None, None]
    assert torch.allclose(found[0], expected, rtol=1e-12)


@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
def test_a_gain_is_a_factor_of_all_frfs(mesh, kind):
    found = _frf(_model(mesh, {"gain": SensorGain()}, gain_gain=1.37), kind=kind)
    assert torch.allclose(found, 1.37 * _frf(_model(mesh), kind=kind), rtol=1e-12)


def test_a_displaced_sensor_reads_the_place_where_it_sits(mesh):
    dx, dy = 0.013, -0.021
    found = _frf(_model(mesh, {"off": SensorPosition()}, off_dx=dx, off_dy=dy))
    places = mesh.places(RESPONSE) + torch.tensor([dx / mesh.length_x, dy / mesh.length_y], dtype=torch.float64)
    # The force stays at the place that its label says, though node 3 is a response and a reference.
    assert torch.allclose(found, _frf(_model(mesh), places), rtol=1e-12)


def test_metres_are_those_of_the_plate_as_it_is(mesh):
    effects = {"sides": AspectRatio(), "off": SensorPosition()}
    found = _frf(_model(mesh, effects, sides_ratio=1.21, off_dx=0.02, off_dy=0.01))
    offset = torch.tensor([0.02 / (mesh.length_x / 1.1), 0.01 / (mesh.length_y * 1.1)], dtype=torch.float64)
    expected = _frf(_model(mesh, {"sides": AspectRatio()}, sides_ratio=1.21), mesh.places(RESPONSE) + offset)
    assert torch.allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(("response", "index"), [(8, 1), ((0.61, 0.72), 2)])
def test_one_sensor_may_be_off_alone(mesh, response, index):
    found = _frf(_model(mesh, {"off": SensorPosition(response)}, off_dx=0.013, off_dy=0.008))
    places = mesh.places(RESPONSE)
    places[index] += torch.tensor([0.013 / mesh.length_x, 0.008 / mesh.length_y], dtype=torch.float64)
    assert torch.allclose(found, _frf(_model(mesh), places), rtol=1e-12)
    assert not torch.allclose(found[:, index], _frf(_model(mesh))[:, index], rtol=1e-3)


# FRFs [response, reference] that a list of channels names, in the order of RESPONSE and REFERENCE.
NAMED = {
    "one FRF": (((8, 9),), [(1, 0)]),
    "a place": ((((0.61, 0.72), 3),), [(2, 1)]),
    "a response": (((3, None),), [(0, 0), (0, 1)]),
    "a reference": (((None, 3),), [(0, 1), (1, 1), (2, 1)]),
    "a label of both": ((3,), [(0, 0), (0, 1)]),
    "a label of a reference": ((9,), [(0, 0), (1, 0), (2, 0)]),
    "two that overlap": ((8, (None, 3)), [(1, 0), (1, 1), (0, 1), (2, 1)]),
    "one that is not asked for": (((8, 12), 17), []),
}


@pytest.mark.parametrize("case", NAMED)
def test_the_named_channels_have_the_other_sign(mesh, case):
    channels, named = NAMED[case]
    expected = _frf(_model(mesh))
    for pair in named:
        expected[:, *pair] *= -1
    found = _frf(_model(mesh, {"sign": ChannelPolarity(channels)}))
    assert torch.allclose(found, expected, rtol=1e-12)


SWAPPED = {
    "two FRFs": (((3, 9), ((0.61, 0.72), 3)), [((0, 0), (2, 1))]),
    "two responses": ((3, 8), [((0, 0), (1, 0)), ((0, 1), (1, 1))]),
    "two references": (((None, 9), (None, 3)), [((0, 0), (0, 1)), ((1, 0), (1, 1)), ((2, 0), (2, 1))]),
    "none that is asked for": ((12, 17), []),
}


@pytest.mark.parametrize("case", SWAPPED)
@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
def test_exchanged_labels_exchange_the_readings(mesh, case, kind):
    channels, pairs = SWAPPED[case]
    plain = _frf(_model(mesh), kind=kind)
    expected = plain.clone()
    for one, other in pairs:
        expected[:, *one], expected[:, *other] = plain[:, *other], plain[:, *one]
    found = _frf(_model(mesh, {"swap": ChannelSwap(channels)}), kind=kind)
    assert torch.allclose(found, expected, rtol=1e-12)


def test_a_reading_takes_its_sign_along_when_labels_are_exchanged_later(mesh):
    sign, swap = ChannelPolarity(((3, 9),)), ChannelSwap((3, 8))
    plain = _frf(_model(mesh))
    first, last = (_frf(_model(mesh, effects)) for effects in ({"a": sign, "b": swap}, {"a": swap, "b": sign}))
    # The sensor at node 3 is upside down, and then read under 8; or what is read under 3 has the wrong sign.
    assert torch.allclose(first[:, 1, 0], -plain[:, 0, 0], rtol=1e-12)
    assert torch.allclose(first[:, 0, 0], plain[:, 1, 0], rtol=1e-12)
    assert torch.allclose(last[:, 1, 0], plain[:, 0, 0], rtol=1e-12)
    assert torch.allclose(last[:, 0, 0], -plain[:, 1, 0], rtol=1e-12)


def test_two_exchanges_are_one_of_three(mesh):
    plain = _frf(_model(mesh))
    third = (0.61, 0.72)
    found = _frf(_model(mesh, {"a": ChannelSwap((3, 8)), "b": ChannelSwap((8, (third, None)))}))
    # Under 3 the sensor at 8; under 8 what the third label had; under the third what 8 had, the sensor at 3.
    assert torch.allclose(found, plain[:, [1, 2, 0]], rtol=1e-12)


def test_a_label_means_the_channel_that_sits_nearest_to_it(mesh):
    # Coordinates of a measured channel are some millimetres off the node of its label.
    places = [(place[0] + 0.006, place[1] - 0.004) for place in mesh.places([8, 10]).tolist()]
    places.append((0.03, 0.23) if mesh.n_x == 6 else (0.23, 0.22))
    plain = _frf(_model(mesh), places)
    found = _frf(_model(mesh, {"sign": ChannelPolarity((8,))}), places)
    assert torch.allclose(found, plain * torch.tensor([-1.0, 1.0, 1.0]).double()[:, None], rtol=1e-12)


def test_a_transmissibility_has_responses_to_name():
    mesh = MESHES["square"]
    plain = _model(mesh).frf(NONE, LINES, [3, 8], kind="transmissibility")
    effects = {"sign": ChannelPolarity((8,)), "swap": ChannelSwap((3, 8))}
    found = _model(mesh, effects).frf(NONE, LINES, [3, 8], kind="transmissibility")
    assert torch.allclose(found, torch.stack([-plain[:, 1], plain[:, 0]], dim=1), rtol=1e-12)


def test_where_a_label_is_read_is_told_beside_a_gain_and_a_delay_that_read_nothing_elsewhere(mesh):
    swap = ChannelSwap([(3, None), (8, None)])
    for more in ({}, {"loud": SensorGain(), "late": TimeDelay()}):
        effects = {"plate": Plate(), "loss": HystereticDamping(), **more, "swap": swap}
        known = KNOWN | {"loud.gain": 1.7, "late.delay": 2e-4} if more else KNOWN
        response, reference = PlateModel(mesh, effects, known, {}, RESPONSE, REFERENCE, "mobility").read_from()
        assert response.tolist() == [1, 0, 2]
        assert reference.tolist() == [0, 1]


def test_half_an_exchange_is_refused(mesh):
    model = _model(mesh, {"swap": ChannelSwap((3, 8))})
    with pytest.raises(ValueError, match="both among the FRFs asked for"):
        _frf(model, [3])
    with pytest.raises(ValueError, match="two channels of one kind"):
        _frf(_model(mesh, {"swap": ChannelSwap((3, (8, 9)))}))


def test_channels_that_cannot_be_are_refused_when_the_model_is_made(mesh):
    with pytest.raises(ValueError, match="to name its channels"):
        ChannelPolarity()
    with pytest.raises(ValueError, match="two channels, got 3"):
        ChannelSwap((1, 2, 3))
    for effect in (ChannelPolarity(((3, 99),)), ChannelSwap((3, 99)), SensorPosition(99)):
        with pytest.raises(ValueError, match="Expected node labels from 1 to"):
            _model(mesh, {"wrong": effect})


@pytest.mark.parametrize(
    "effect",
    [
        ChannelSwap(channels=[(3, None), (8, None)]),
        ChannelSwap(channels=[(None, 9), (None, 3)]),
        ChannelSwap(channels=[(3, 9), (8, 3)]),
        ChannelPolarity(channels=[(8, None), (3, 3)]),
    ],
    ids=["responses", "references", "frfs", "polarity"],
)
def test_channels_are_exchanged_and_turned_in_frfs_that_are_there(mesh, effect):
    """Also where some are exchanged and turned already, and one stands elsewhere and another is too loud."""
    others = {
        "swap": ChannelSwap(channels=[(3, 3), (8, 9)]),
        "turned": ChannelPolarity(channels=[(3, None)]),
        "loud": SensorGain(),
        "off": SensorPosition(3),
        "late": TimeDelay(),
        "window": ExponentialWindow(),
    }
    value = {"loud_gain": 1.3, "off_dx": 0.013, "off_dy": 0.008, "late_delay": 2e-4, "window_rate": 3.0}
    for before in ({}, others):
        known = value if before else {}
        plain, whole = (_model(mesh, {**before, **more}, **known) for more in ({}, {"more": effect}))
        for model in (plain, whole):
            model.response, model.reference, model.kind = RESPONSE, REFERENCE, "accelerance"
        found = plain.rearranged(plain.frf(NONE, LINES), effect)
        assert torch.allclose(found, whole.frf(NONE, LINES), rtol=1e-12)
        assert not torch.allclose(found, plain.frf(NONE, LINES), rtol=1e-3)


@pytest.mark.parametrize("effect", [SensorGain(), ExponentialWindow(), HystereticDamping()])
def test_what_does_more_than_exchange_and_turn_is_not_rearranged(mesh, effect):
    model = _model(mesh)
    model.response, model.reference, model.kind = RESPONSE, REFERENCE, "accelerance"
    assert model.rearranged(model.frf(NONE, LINES), effect) is None
