"""An accelerometer that moves from point to point."""

import pytest
import torch

from torchplate.effects import Effect, HystereticDamping, Plate, PointMass, RovingMass, SensorPosition
from torchplate.model import PlateModel, Searched, reduce
from torchplate.plate import Mesh

STEEL = {"plate.youngs_modulus": 205e9, "plate.poisson_ratio": 0.29, "plate.density": 7850.0, "plate.thickness": 0.002}
LOSS = {"loss.stiffness_loss_factor": 0.01}
PLACES = [(0.13, 0.27), (0.61, 0.94), (0.83, 0.38)]
REFERENCE = [(0.42, 0.71), 8]
LINES = torch.linspace(15.0, 400.0, 87, dtype=torch.float64)
NONE = torch.zeros(0, dtype=torch.float64)
MASS = 0.031
# Two ways to the same matrices: rounding at the scale of the highest eigenvalue.
ROUNDING = 1e-9


def _model(mesh: Mesh, effects: dict, known: dict, **more) -> PlateModel:
    return PlateModel(
        mesh,
        {"plate": Plate(), "loss": HystereticDamping()} | effects,
        STEEL | LOSS | known,
        reference=REFERENCE,
        **more,
    )


def _distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
@pytest.mark.parametrize("mesh", [Mesh(0.5, 0.3, 6, 4), Mesh(0.4, 0.4, 5, 5)], ids=["rectangle", "square"])
def test_each_record_is_that_of_the_plate_with_the_mass_at_its_own_response(mesh: Mesh, kind: str):
    found = _model(mesh, {"own": RovingMass()}, {"own.mass": MASS}).frf(NONE, LINES, PLACES, kind=kind)
    for index, (x, y) in enumerate(PLACES):
        alone = _model(mesh, {"own": PointMass()}, {"own.x": x, "own.y": y, "own.mass": MASS})
        expected = alone.frf(NONE, LINES, [(x, y)], kind=kind)
        assert _distance(found[:, index], expected[:, 0]) < ROUNDING
        # And not that of one plate: the poles of the records differ.
        others = [other for other in range(len(PLACES)) if other != index]
        assert _distance(found[:, others], alone.frf(NONE, LINES, PLACES, kind=kind)[:, others]) > 0.05


def test_the_base_that_moves_loads_the_sensor_too():
    mesh = Mesh(0.5, 0.3, 6, 4, edges={"x0": "clamped"})

    def read(own: Effect, numbers: dict, places: list) -> torch.Tensor:
        known = STEEL | LOSS | {f"own.{name}": value for name, value in numbers.items()}
        effects = {"plate": Plate(), "loss": HystereticDamping(), "own": own}
        return PlateModel(mesh, effects, known, kind="transmissibility").frf(NONE, LINES, places)

    found = read(RovingMass(), {"mass": MASS}, PLACES)
    for index, (x, y) in enumerate(PLACES):
        expected = read(PointMass(), {"x": x, "y": y, "mass": MASS}, [(x, y)])
        assert _distance(found[:, index], expected[:, 0]) < ROUNDING


def test_the_mass_sits_where_the_sensor_really_sits():
    mesh, off = Mesh(0.5, 0.3, 6, 4), (0.02, -0.013)
    moved = {"own": RovingMass(), "off": SensorPosition()}
    found = _model(mesh, moved, {"own.mass": MASS, "off.dx": off[0], "off.dy": off[1]}).frf(NONE, LINES, PLACES)
    there = [(x + off[0] / 0.5, y + off[1] / 0.3) for x, y in PLACES]
    expected = _model(mesh, {"own": RovingMass()}, {"own.mass": MASS}).frf(NONE, LINES, there)
    assert _distance(found, expected) < ROUNDING


def test_many_responses_go_in_parts_and_read_the_same():
    mesh = Mesh(0.5, 0.3, 6, 4)
    model = _model(mesh, {"own": RovingMass()}, {"own.mass": MASS})
    every = list(range(1, 22))
    whole = model.frf(NONE, LINES, every)
    for index in (0, 7, 8, 20):
        assert _distance(whole[:, index], model.frf(NONE, LINES, [every[index]])[:, 0]) < ROUNDING


def test_two_sensors_at_the_response_weigh_what_they_weigh_together():
    mesh = Mesh(0.5, 0.3, 6, 4)
    two = _model(mesh, {"one": RovingMass(), "cable": RovingMass()}, {"one.mass": 0.02, "cable.mass": 0.011})
    one = _model(mesh, {"own": RovingMass()}, {"own.mass": MASS})
    assert _distance(two.frf(NONE, LINES, PLACES), one.frf(NONE, LINES, PLACES)) < ROUNDING


def test_plates_that_share_their_modes_share_them_with_a_sensor_that_moves():
    mesh = Mesh(0.5, 0.3, 6, 4)
    searched = {"plate.youngs_modulus": Searched(180e9, 230e9), "own.mass": Searched(0.0, 0.05)}
    known = {key: value for key, value in (STEEL | LOSS).items() if key not in searched}
    effects = {"plate": Plate(), "loss": HystereticDamping(), "own": RovingMass()}
    model = PlateModel(mesh, effects, known, searched, PLACES, REFERENCE, "accelerance")
    outcome = reduce(model, LINES)
    assert outcome is not None
    small, error = outcome
    assert small.shared_modes is not None
    theta = model.space.to_si(torch.rand(5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(3)))
    # What `reduce` found at the worst member that it looked at, of the worst FRF; others may be a little worse.
    assert _distance(small.frf(theta, LINES), model.frf(theta, LINES)) < 5 * max(error, ROUNDING)
