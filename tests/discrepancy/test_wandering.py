"""A plate whose section wanders is that plate: against elements that really differ, and what it is linear in."""

import math

import pytest
import torch

from torchplate.discrepancy.judged import Knowledge
from torchplate.discrepancy.marginal import Marginal
from torchplate.discrepancy.modal_change import sum_of_modes
from torchplate.discrepancy.nuisance import _apart, nuisances, specimen_columns
from torchplate.discrepancy.specimen import Found, Specimens, as_it_is_meant
from torchplate.discrepancy.wandering import Elements, Wandering, section_off, terms
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT
from torchplate.model import PlateModel
from torchplate.model.discretisation.reduced_basis import ritz_basis
from torchplate.plate import Mesh

NOBODY = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(20.0, 300.0, 240, dtype=torch.float64)
KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.3,
    "plate.density": 7860.0,
    "plate.thickness": 0.0027,
    "wires.stiffness": 1300.0,
    "wires.viscous_damping": 0.5,
    "loss.stiffness_loss_factor": 3e-3,
    "grain.young_ratio": 1.0,
    "grain.shear_factor": 1.0,
}
WANDERING = Wandering(5e-3, 8e-3, 0.02, 2)
GENERATOR = torch.Generator().manual_seed(4)
# Of five cosines thickness and modulus, by turns, and two of the grain.
SHIFT = torch.randn(12, generator=GENERATOR, dtype=torch.float64)
SPREAD = torch.eye(12, dtype=torch.float64)


PATCH = {"patch.x": 0.3, "patch.y": 0.64, "patch.size": 0.35, "patch.factor": 0.4}
# Dashpots of the wires couple modes, which the nuisances leave out: here they hardly do.
SMOOTH = {"wires.viscous_damping": 0.02}


def plate(**changed: float) -> PlateModel:
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](nodes=(2, 10, 61, 69)),
        "loss": CATALOGUE["hysteretic_damping"](),
        "grain": CATALOGUE["orthotropy"](),
    }
    if "patch.x" in changed:
        effects["patch"] = CATALOGUE["stiffness_loss"]()
    return PlateModel(Mesh(0.48, 0.4, 8, 7), effects, KNOWN | changed, {}, [3, 17], [7, 9, 21], "accelerance")


def reduced(model: PlateModel) -> PlateModel:
    return model.projected(ritz_basis(model, NOBODY[None], torch.tensor([300.0], dtype=torch.float64), 0, 3.0))


def only(name: str) -> torch.Tensor:
    """The shift of one group, the others at rest."""
    names = [one.name for one in terms(plate(), plate().plan(NOBODY), WANDERING)]
    return torch.where(torch.tensor([one == name for one in names]), SHIFT, 0.0)


def test_terms_that_wander_alike_are_multiples_of_one_product(monkeypatch):
    """What each adds is the same where it is asked for alone; a shape's rows are weighed once for all its terms."""
    model = reduced(plate(**PATCH))
    plan = model.plan(NOBODY)
    every = terms(model, plan, WANDERING)
    weighed, way = [], Elements._weighed
    monkeypatch.setattr(Elements, "_weighed", lambda self, weight: weighed.append(way(self, weight)) or weighed[-1])
    together = Elements(model, plan)
    found = [(together.stiffness(one.stiffness, one.coefficient), together.mass(one.mass)) for one in every]
    # Five cosines, and the grain that is everywhere.
    assert len(every) == 12
    assert len({id(rows) for rows, _ in weighed}) == 6
    for one, pair in zip(every, found, strict=True):
        # Of each alone nothing is known before.
        alone = Elements(model, plan).stiffness(one.stiffness, one.coefficient), Elements(model, plan).mass(one.mass)
        for part, other in zip(pair, alone, strict=True):
            assert float((part - other).abs().max()) <= 1e-12 * float(other.abs().max())
    # Its sign and its size are in the multiple.
    turned = together.stiffness(-2.5 * every[-1].stiffness, every[-1].coefficient)
    assert float((turned + 2.5 * found[-1][0]).abs().max()) <= 1e-12 * float(turned.abs().max())


def test_a_grain_that_is_found_is_orthotropy():
    model = Specimens(reduced(plate()), NOBODY, WANDERING).at(only("grain"))
    young, shear = (1 + WANDERING.grain * float(one) for one in SHIFT[-2:])
    other = plate(**{"grain.young_ratio": young, "grain.shear_factor": shear})
    found, wanted = (one.natural_frequencies(NOBODY, 12)[3:] for one in (model, other))
    plain = plate().natural_frequencies(NOBODY, 12)[3:]
    # Linear in a grain of 2 %: its square is left, 4e-4 of the rigidity.
    assert float((found / wanted - 1).abs().max()) < 3e-4
    assert float((found / plain - 1).abs().max()) > 3e-3


@pytest.mark.parametrize("patch", [{}, PATCH], ids=["sound", "patched"])
@pytest.mark.parametrize("name", ["thickness", "modulus"])
def test_a_section_that_wanders_is_that_of_elements_that_differ(name, patch):
    model = plate(**patch)
    plan, shift = model.plan(NOBODY), only(name)
    place = model.mesh.element_place
    field = torch.zeros(len(place), dtype=torch.float64)
    pairs = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
    size = sum(0.5 if 0 in pair else 0.25 for pair in pairs) ** -0.5
    # Means of squared cosines over the middles of elements are those over the plate.
    for pair, far in zip(sorted(pairs, key=lambda one: (sum(one), one)), shift[shift != 0].tolist(), strict=True):
        shape = (math.pi * pair[0] * place[:, 0]).cos() * (math.pi * pair[1] * place[:, 1]).cos()
        field += far * (WANDERING.thickness if name == "thickness" else WANDERING.modulus) * size * shape
    power, heavier = (3, field) if name == "thickness" else (1, 0 * field)
    rigidity = plan.section.rigidity * (1 + power * field)[:, None, None]
    stiffness = model.assembly.stiffness(rigidity, plan.geometry)
    mass = model.assembly.mass(plan.section.areal_mass * (1 + heavier), plan.geometry)
    uniform = model.assembly.stiffness(plan.section.rigidity, plan.geometry)
    wires = model.assembly.system(*plan).stiffness - uniform
    lower = torch.linalg.cholesky(mass)
    whitened = torch.linalg.solve_triangular(lower, stiffness + wires, upper=False)
    whitened = torch.linalg.solve_triangular(lower, whitened.mT, upper=False)
    wanted = torch.linalg.eigvalsh(0.5 * (whitened + whitened.mT))[:12].sqrt() / (2 * math.pi)
    found = Specimens(reduced(model), NOBODY, WANDERING).at(shift).natural_frequencies(NOBODY, 12)
    # What the basis of a uniform plate leaves of the modes of this one.
    assert float((found / wanted - 1).abs().max()) < 2e-5
    plain = model.natural_frequencies(NOBODY, 12)
    assert float((plain / wanted - 1).abs().max()) > 5e-4


def test_a_basis_of_a_section_that_is_off_holds_that_specimen():
    """Modes above those of a basis take part where the section wanders; those of the specimen itself hold them."""
    model, far = plate(), 4.0 * only("thickness")
    truth = Specimens(model.projected(torch.eye(len(model.mesh.free_dof), dtype=torch.float64)), NOBODY, WANDERING)
    wanted, off = truth.at(far).frf(NOBODY, LINES), []
    for like in (model, model.with_section_off(section_off(WANDERING, far))):
        basis = ritz_basis(like, NOBODY[None], torch.tensor([300.0], dtype=torch.float64), 0, 3.0)
        found = Specimens(model.projected(basis), NOBODY, WANDERING).at(far).frf(NOBODY, LINES)
        off.append(float((found - wanted).norm() / wanted.norm()))
    assert off[1] < 0.2 * off[0]


def test_a_model_forgets_how_it_wandered():
    model = reduced(plate())
    off = torch.cat([SHIFT, SHIFT[:3]])
    back = as_it_is_meant(Specimens(model, NOBODY, WANDERING, 0.2, 3).at(off))
    assert torch.equal(back.frf(NOBODY, LINES), model.frf(NOBODY, LINES))


def test_the_likelihood_hangs_little_on_where_it_is_linear():
    """Where shifts are a hundredth of a peak's width, taken about them or about none is the same."""
    wandering = Wandering(4e-6, 4e-6, 2e-5, 2)
    model, still = reduced(plate()), torch.zeros_like(LINES)
    specimens = Specimens(model, NOBODY, wandering)
    truth = specimens.at(SHIFT).frf(NOBODY, LINES)
    noise = 1e-2 * truth.abs().square().mean(0).sqrt()
    generator = torch.Generator().manual_seed(1)
    draw = torch.randn(2, *truth.shape, generator=generator, dtype=torch.float64)
    measured = truth + noise * torch.complex(draw[0], draw[1])
    every = torch.ones(truth.shape[1:], dtype=torch.bool)
    costs = []
    for about in (None, Found(SHIFT, SPREAD)):
        there = specimens.of(about)
        columns = nuisances(there, NOBODY, LINES, PERFECT, wandering, still, about)
        variance = noise.square().expand(truth.shape)
        marginal = Marginal(variance, columns, every, {}, Knowledge(), about=about)
        judged = marginal.judge(marginal.residual(measured - there.frf(NOBODY, LINES)))
        assert judged.found is not None
        costs.append((judged.cost, judged.noise_scale, judged.found.shift))
    assert costs[0][0] == pytest.approx(costs[1][0], abs=2.0)
    assert costs[0][1] == pytest.approx(costs[1][1], rel=1e-3)
    assert float((costs[0][2] - costs[1][2]).abs().max()) < 0.1


def test_a_specimen_is_read_as_its_modes_say():
    """What the nuisances take apart is the FRF itself, dampings that are off their law included."""
    specimens = Specimens(reduced(plate(**SMOOTH)), NOBODY, WANDERING, 0.2, 6)
    off = torch.cat([SHIFT, torch.tensor([2.0, -1.0, 0.5, 3.0, -2.0, 1.0], dtype=torch.float64)])
    model = specimens.at(off)
    _, _, modal, to_reading = _apart(model, NOBODY, LINES)
    found = to_reading(sum_of_modes(modal, modal.left, modal.right))
    wanted = model.frf(NOBODY, LINES)
    assert float((found - wanted).norm() / wanted.norm()) < 2e-3
    lawful = specimens.at(SHIFT).frf(NOBODY, LINES)
    assert float((lawful - wanted).norm() / wanted.norm()) > 0.1


@pytest.mark.parametrize("index", [0, 1, 11, 12, 15])
def test_each_way_to_be_off_changes_the_frfs_as_it_is_said(index):
    specimens = Specimens(reduced(plate(**SMOOTH)), NOBODY, WANDERING, 0.2, 6)
    off = torch.cat([SHIFT, torch.zeros(6, dtype=torch.float64)])
    step = torch.zeros_like(off)
    step[index] = 1e-4
    columns = specimen_columns(specimens.at(off), NOBODY, LINES, specimens)
    after, before = (specimens.at(off + sign * step).frf(NOBODY, LINES) for sign in (1, -1))
    wanted = (after - before) / 2e-4
    assert float((columns[..., index] - wanted).norm() / wanted.norm()) < 5e-3


def test_a_specimen_with_one_effect_more_is_the_same_specimen():
    model = Specimens(reduced(plate()), NOBODY, WANDERING, 0.2, 3).at(torch.cat([SHIFT, SHIFT[:3]]))
    effects = {**model.effects, "amplifier": CATALOGUE["sensor_gain"]()}
    more = model.replaced(effects=effects, known=model.known_values | {"amplifier.gain": 1.0})
    assert torch.equal(more.frf(NOBODY, LINES), model.frf(NOBODY, LINES))
