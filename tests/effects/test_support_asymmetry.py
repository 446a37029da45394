"""Supports that are not all alike."""

import math

import pytest
import torch

from torchplate.effects import GroundSpring, Plate, SupportAsymmetry, SupportSpring
from torchplate.model import PlateModel
from torchplate.plate import Mesh

# Thick: a rigid body on its springs. The first bending mode lies at 1 kHz, the springs' modes at some hertz.
STEEL = {"plate.youngs_modulus": 210e9, "plate.poisson_ratio": 0.3, "plate.density": 7800.0, "plate.thickness": 0.02}
NONE = torch.zeros(0, dtype=torch.float64)
CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
SIDES = {"rectangle": (0.3, 0.2), "square": (0.25, 0.25)}


def _model(sides, factors, supports=None, asymmetry=None, **more) -> PlateModel:
    effects = {"plate": Plate(), "wires": SupportSpring(at=CORNERS)} if supports is None else supports
    effects = effects | {"uneven": asymmetry or SupportAsymmetry(at=CORNERS)}
    known = {f"uneven.factor_{index + 1}": factor for index, factor in enumerate(factors)}
    return PlateModel(Mesh(*sides, 3, 2), effects, STEEL | {"wires.stiffness": 900.0} | known | more)


def test_neutral_factors_leave_the_springs_as_they_were():
    neutral = [parameter.neutral for parameter in SupportAsymmetry(at=CORNERS).parameters.values()]
    bare = PlateModel(
        Mesh(0.3, 0.2, 3, 2), {"plate": Plate(), "wires": SupportSpring(at=CORNERS)}, STEEL | {"wires.stiffness": 900.0}
    )
    found = _model(SIDES["rectangle"], neutral).natural_frequencies(NONE, 6)
    assert torch.equal(found, bare.natural_frequencies(NONE, 6))


@pytest.mark.parametrize("shape", SIDES)
def test_a_rigid_body_swings_on_unequal_springs(shape):
    factors = (1.7, 0.4, 1.0, 0.8)
    # w = a + b (x − ½) + c (y − ½): masses m, m/12, m/12; each spring pulls at the corner's (1, ±½, ±½).
    mass = 7800.0 * 0.02 * math.prod(SIDES[shape])
    arm = torch.tensor([[1.0, x - 0.5, y - 0.5] for x, y in CORNERS], dtype=torch.float64)
    inertia = mass * torch.tensor([1.0, 1 / 12, 1 / 12], dtype=torch.float64)
    stiffness = 900.0 * arm.mT @ (torch.tensor(factors, dtype=torch.float64)[:, None] * arm)
    root = inertia.rsqrt()
    expected = torch.linalg.eigvalsh(root[:, None] * stiffness * root).sqrt() / (2 * math.pi)
    found = _model(SIDES[shape], factors).natural_frequencies(NONE, 3)
    # Flexibility lowers these by some (7 Hz / 1 kHz)².
    assert torch.allclose(found, expected, rtol=1e-4)


def test_it_changes_the_named_spring_and_no_other_and_no_dashpot():
    supports = {"plate": Plate(), "wires": SupportSpring(at=CORNERS), "others": SupportSpring(nodes=(6, 7))}
    # A spring that is no support stays, though it sits at one.
    supports |= {"ground": GroundSpring()}
    more = {"others.stiffness": 50.0, "ground.x": 1.0, "ground.y": 0.0, "ground.stiffness": 7.0}
    more |= {"wires.viscous_damping": 0.3}
    # On the 3 × 2 mesh node 4 is the corner (1, 0).
    plan = _model((0.3, 0.2), (3.0,), supports, SupportAsymmetry(nodes=(4,)), **more).plan(NONE)
    assert [term.stiffness.tolist() for term in plan.terms] == [[900.0, 2700.0, 900.0, 900.0], [50.0, 50.0], [7.0]]
    assert plan.terms[0].viscous.tolist() == [0.3] * 4


def test_it_may_stand_before_the_supports_in_a_config():
    factors, lines = (1.7, 0.4, 1.0, 0.8), torch.tensor([3.0, 9.0, 700.0], dtype=torch.float64)
    model = _model((0.3, 0.2), factors)
    turned = PlateModel(
        model.mesh,
        dict(reversed(model.effects.items())),
        {"wires.stiffness": 900.0, **STEEL, **{f"uneven.factor_{i + 1}": factor for i, factor in enumerate(factors)}},
    )
    assert torch.equal(model.frf(NONE, lines, [2], [5]), turned.frf(NONE, lines, [2], [5]))


def test_it_has_one_factor_for_each_node_in_their_order():
    assert list(SupportAsymmetry(nodes=(2, 10, 7)).parameters) == ["factor_1", "factor_2", "factor_3"]
    with pytest.raises(ValueError, match="No parameter named"):
        _model((0.3, 0.2), (1.0,) * 5)


def test_a_place_without_a_support_is_refused_when_the_model_is_made():
    with pytest.raises(ValueError, match=r"got none at \[5\]"):
        _model((0.3, 0.2), (1.0, 1.0), asymmetry=SupportAsymmetry(nodes=(4, 5)))


@pytest.mark.parametrize("places", [{}, {"nodes": (1,), "at": ((0.5, 0.5),)}])
def test_both_or_neither_way_of_naming_the_places_is_refused(places):
    with pytest.raises(ValueError, match="either `nodes`"):
        SupportAsymmetry(**places)
