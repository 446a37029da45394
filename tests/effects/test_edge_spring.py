"""An edge that is held elastically."""

import math

import pytest
import torch

from torchplate.effects import EdgeSpring, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

STEEL = {"plate.youngs_modulus": 210e9, "plate.poisson_ratio": 0.3, "plate.density": 7800.0, "plate.thickness": 0.004}
NONE = torch.zeros(0, dtype=torch.float64)
SIDES = {"rectangle": (0.5, 0.3), "square": (0.4, 0.4)}
EDGES = ("x0", "x1", "y0", "y1")


def _frequencies(sides, springs: dict[str, tuple[float, float]], edges=None, thickness=0.004, n_mode=6) -> torch.Tensor:
    effects = {"plate": Plate()} | {edge: EdgeSpring(edge) for edge in springs}
    known = STEEL | {"plate.thickness": thickness}
    for edge, (stiffness, rotational) in springs.items():
        known |= {f"{edge}.stiffness": stiffness, f"{edge}.rotational_stiffness": rotational}
    return PlateModel(Mesh(*sides, 5, 4, edges=edges or {}), effects, known).natural_frequencies(NONE, n_mode)


@pytest.mark.parametrize("shape", SIDES)
@pytest.mark.parametrize("edge", EDGES)
def test_a_rigid_body_swings_on_a_soft_edge(edge, shape):
    sides, stiffness, thickness = SIDES[shape], 800.0, 0.05
    length, mass = sides[1 if edge.startswith("x") else 0], 7800.0 * thickness * math.prod(sides)
    found = _frequencies(sides, {edge: (stiffness, 0.0)}, thickness=thickness, n_mode=3)
    # About the middle of the edge kL/m; bounce and the turn about the edge's line meet in 0 and 4 kL/m:
    # k L (1, ½)(1, ½)ᵀ over masses m and m/12.
    pulses = [math.sqrt(factor * stiffness * length / mass) for factor in (1, 4)]
    # Flexibility lowers them by some (10 Hz / 500 Hz)²; the zero is rounding of the highest eigenvalue.
    assert found[1:].tolist() == pytest.approx([pulse / (2 * math.pi) for pulse in pulses], rel=1e-3)
    assert float(found[0]) < 0.02 * float(found[1])


@pytest.mark.parametrize("shape", SIDES)
@pytest.mark.parametrize("edge", EDGES)
def test_a_rigid_body_turns_against_a_rotational_edge(edge, shape):
    sides, rotational, thickness = SIDES[shape], 30.0, 0.05
    across, length = sides if edge.startswith("x") else sides[::-1]
    mass = 7800.0 * thickness * math.prod(sides)
    found = _frequencies(sides, {edge: (0.0, rotational)}, thickness=thickness, n_mode=3)
    # κ L θ² against m across² θ² / 12.
    pulse = math.sqrt(12 * rotational * length / (mass * across**2))
    assert float(found[2]) == pytest.approx(pulse / (2 * math.pi), rel=1e-3)
    assert float(found[1]) < 0.02 * float(found[2])


@pytest.mark.parametrize("shape", SIDES)
@pytest.mark.parametrize("held", [("x0",), ("y1", "x1"), EDGES])
def test_stiff_springs_are_a_held_edge(held, shape):
    sides = SIDES[shape]
    # Springs 1e6 times the plate's own D/L³ leave up to 6e-4 of a frequency, ten times stiffer ones a tenth of that.
    stiff = 1e6 * 210e9 * 0.004**3 / (12 * 0.91) / sides[1] ** 3
    turning = stiff * sides[1] ** 2
    for condition, springs in (("simply_supported", (stiff, 0.0)), ("clamped", (stiff, turning))):
        found = _frequencies(sides, dict.fromkeys(held, springs))
        expected = _frequencies(sides, {}, dict.fromkeys(held, condition))
        flexible = expected > 1e-3 * expected.max()
        assert torch.allclose(found[flexible], expected[flexible], rtol=1e-3), condition


def test_an_edge_that_is_none_is_refused():
    for edge in ("north", ""):
        with pytest.raises(ValueError, match=r"one of x0, x1, y0, y1, got"):
            EdgeSpring(edge)


def test_rows_along_an_edge_are_made_once_for_a_mesh_and_never_by_a_transform(monkeypatch):
    mesh, other = (Mesh(0.5, 0.3, 4, 3) for _ in range(2))
    value = {key: torch.tensor(5.0, dtype=torch.float64) for key in ("stiffness", "rotational_stiffness")}

    def rows(effect: EdgeSpring, mesh: Mesh) -> list[torch.Tensor]:
        return [term.vector for term in effect.attached(mesh, [], value)]

    def slope(stiffness: torch.Tensor) -> torch.Tensor:
        return EdgeSpring("y1").attached(mesh, [], {**value, "stiffness": stiffness})[0].stiffness.sum()

    torch.func.vmap(slope)(torch.ones(2, dtype=torch.float64))
    assert not mesh.known_along_edges
    first, again, fresh = rows(EdgeSpring("y1"), mesh), rows(EdgeSpring("y1"), mesh), rows(EdgeSpring("y1"), other)
    for one, same, new in zip(first, again, fresh, strict=True):
        assert one is same
        assert one is not new
        assert torch.equal(one, new)
    for one, elsewhere in zip(first, rows(EdgeSpring("y0"), mesh), strict=True):
        assert not torch.equal(one, elsewhere)
    # Of a fine mesh they are many.
    monkeypatch.setattr("torchplate.effects.edge_spring.KEPT", (2 * 12 + 2 * 12 + 2 * 9) * 20 * 3 * 8 - 1)
    assert rows(EdgeSpring("x0"), mesh)[1] is not rows(EdgeSpring("x0"), mesh)[1]
    monkeypatch.setattr("torchplate.effects.edge_spring.KEPT", (2 * 12 + 2 * 12 + 2 * 9) * 20 * 3 * 8)
    assert rows(EdgeSpring("x0"), mesh)[1] is rows(EdgeSpring("x0"), mesh)[1]
