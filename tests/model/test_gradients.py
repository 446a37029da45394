"""Derivatives of FRFs against a direct solve, where natural frequencies repeat and where they do not.

The referee `frf_direct` solves Z(s) at every line, with no mode at all, and stock autograd differentiates that solve.
"""

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from torch.func import grad, hessian, jacfwd, jacrev, vmap

from torchplate.effects import (
    CATALOGUE,
    Effect,
    HystereticDamping,
    Orthotropy,
    Parameter,
    Plate,
    PointMass,
    SupportSpring,
)
from torchplate.model import PlateModel, Searched, reduce
from torchplate.plate import Mesh, Section

# torch.func.jacfwd loads its own rules by torch.jit.script, which warns of itself.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")

SQUARE, RECTANGLE = Mesh(0.48, 0.48, 5, 5), Mesh(0.7, 0.4, 6, 4)
SHAPES = pytest.mark.parametrize("mesh", [SQUARE, RECTANGLE], ids=["square", "rectangle"])
# A square has modes in pairs, the harder case of a derivative: the rectangle is for `make check`.
SQUARE_FIRST = pytest.mark.parametrize(
    "mesh", [pytest.param(SQUARE, id="square"), pytest.param(RECTANGLE, id="rectangle", marks=pytest.mark.check)]
)
# What the issue asks for; rounding at the scale of the highest eigenvalue leaves about 1e-10.
AGREEMENT = 1e-6
EVERYTHING = {
    "plate.youngs_modulus": Searched(6.3e10, 7.7e10),
    "plate.poisson_ratio": Searched(0.25, 0.35),
    "plate.density": Searched(2500.0, 2900.0),
    "plate.thickness": Searched(0.0028, 0.0033),
    "wires.stiffness": Searched(1e3, 2e4, logarithmic=True),
    "wires.viscous_damping": Searched(1.0, 20.0),
    "loss.stiffness_loss_factor": Searched(1e-3, 3e-2),
    "loss.mass_loss_factor": Searched(10.0, 3e3),
    "rayleigh.mass_coefficient": Searched(0.5, 5.0),
    "rayleigh.stiffness_coefficient": Searched(1e-6, 2e-5),
    "lump.mass": Searched(0.01, 0.2),
}


def _examples() -> Mapping[str, tuple]:
    """The examples that the effects' own tests keep, one for each effect."""
    path = Path(__file__).parents[1] / "effects" / "conftest.py"
    spec = importlib.util.spec_from_file_location("examples_of_effects", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.EXAMPLES


def lines(plates, mesh: Mesh, n_line: int = 7) -> torch.Tensor:
    return torch.linspace(0.4, 6.3, n_line, dtype=torch.float64) * plates.first_bending(mesh)


def inside(model: PlateModel, *batch: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*batch, len(model.names), generator=generator, dtype=torch.float64)


def on_cube(evaluate: Callable[..., torch.Tensor], model: PlateModel, *given: object) -> Callable:
    """Real and imaginary parts over the unit cube, where every parameter is of order one."""
    return lambda position: torch.view_as_real(evaluate(model.space.to_si(position), *given))


def jacobian_error(found: torch.Tensor, expected: torch.Tensor) -> float:
    """Largest error of a parameter's column, relative to the largest entry of that column."""
    assert found.shape == expected.shape
    assert bool(found.isfinite().all())
    scale = expected.flatten(0, -2).abs().amax(0)
    return ((found - expected).flatten(0, -2).abs().amax(0) / scale.clamp(min=1e-300)).max().item()


@SQUARE_FIRST
@pytest.mark.parametrize("name", list(CATALOGUE))
def test_every_effect_has_exact_gradients(plates, name: str, mesh: Mesh) -> None:
    examples = _examples()
    if name not in examples:
        pytest.fail(f"The effect '{name}' has no example. Add one to EXAMPLES in tests/effects/conftest.py.")
    options, value = examples[name]
    own = CATALOGUE[name](**options)
    label = "plate" if isinstance(own, Plate) else "own"
    base = {"plate": Plate(), "wires": SupportSpring(at=((0.21, 0.0), (0.66, 0.94))), "loss": HystereticDamping()}
    # Some effects change what only a plate with a grain has.
    base["grain"] = Orthotropy()
    known = dict(zip(("youngs_modulus", "poisson_ratio", "density"), plates.metals["aluminium"], strict=True))
    values = {
        **{f"plate.{key}": number for key, number in known.items()},
        "plate.thickness": 0.003,
        "wires.stiffness": 3e3,
        "loss.stiffness_loss_factor": 0.01,
        "grain.young_ratio": 0.6,
        "grain.shear_factor": 1.2,
    }
    # The plate's modulus is always searched, so that the modes move too.
    wanted = {"plate.youngs_modulus": 7e10} | {f"{label}.{key}": number for key, number in value.items()}
    searched = {
        key: Searched(number - 0.01 * abs(number), number + 0.01 * abs(number)) for key, number in wanted.items()
    }
    model = PlateModel(
        mesh,
        base | {label: own},
        {key: v for key, v in values.items() if key not in searched},
        searched,
        [3, (0.6, 0.7)],
        [8],
    )
    frequency, middle = lines(plates, mesh, 4), torch.full((len(searched),), 0.5, dtype=torch.float64)
    fast, direct = on_cube(model.frf, model, frequency), on_cube(model.frf_direct, model, frequency)
    found, expected = jacrev(fast)(middle), jacrev(direct)(middle)
    assert jacobian_error(found, expected) < AGREEMENT
    assert jacobian_error(jacfwd(fast)(middle), expected) < AGREEMENT
    # Values that autograd never sees: the step's square, 1e-6 of 1 %, and rounding over the step, 1e-10 / 1e-3.
    step = 1e-3
    columns = [
        (direct(middle + step * e) - direct(middle - step * e)) / (2 * step) for e in torch.eye(len(middle)).double()
    ]
    differences = torch.stack(columns, dim=-1)
    # A gradient that is zero is still compared: with 1e-6 of the FRF.
    floor = 1e-6 * fast(middle).abs().max()
    assert bool(((found - differences).abs() <= 1e-4 * differences.abs().amax(dim=(0, 1, 2, 3)) + floor).all())


@SHAPES
@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.parametrize("sides", [([3, 14], [8]), ([3], [8, 20, (0.3, 0.6)])], ids=["two_by_one", "one_by_three"])
@pytest.mark.check
def test_all_parameters_together_have_exact_gradients(plates, mesh: Mesh, loss_field: bool, sides: tuple) -> None:
    searched = EVERYTHING | ({"field.base": Searched(0.001, 0.1)} if loss_field else {})
    model = plates.build(mesh, None, searched, loss_field=loss_field)
    given = (lines(plates, mesh), *sides, "accelerance", 3.0)
    position = inside(model, seed=1)
    expected = jacrev(on_cube(model.frf_direct, model, *given))(position)
    fast = on_cube(model.frf, model, *given)
    assert jacobian_error(jacrev(fast)(position), expected) < AGREEMENT
    assert jacobian_error(jacfwd(fast)(position), expected) < AGREEMENT


def test_a_free_square_plate_has_exact_gradients_at_its_repeated_frequencies(plates) -> None:
    mesh = Mesh(0.4, 0.4, 6, 6)
    searched = {key: EVERYTHING[key] for key in EVERYTHING if key.startswith(("plate", "loss", "rayleigh"))}
    model = plates.build(mesh, None, searched)
    position, frequency = inside(model, seed=2), lines(plates, mesh, 9)
    eigenvalue = model.modes(model.space.to_si(position)).eigenvalue[3:]
    # Rounding at the scale of the highest eigenvalue, against the gap to the next.
    repeated = eigenvalue.diff() < 1e-13 * eigenvalue[-1]
    assert int(repeated.sum()) >= 10
    given = (frequency, [3, 20], [9])
    expected = jacrev(on_cube(model.frf_direct, model, *given))(position)
    assert jacobian_error(jacrev(on_cube(model.frf, model, *given))(position), expected) < AGREEMENT
    assert jacobian_error(jacfwd(on_cube(model.frf, model, *given))(position), expected) < AGREEMENT


@pytest.mark.parametrize("gap", [1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-3])
def test_nearly_repeated_frequencies_have_exact_gradients(plates, gap: float) -> None:
    mesh = Mesh(0.4, 0.4 * (1 + gap), 5, 5)
    model = plates.build(mesh, {"loss.stiffness_loss_factor": 1e-3}, {k: EVERYTHING[k] for k in list(EVERYTHING)[:6]})
    position, given = inside(model, seed=3), (lines(plates, mesh), [3, 20], [9])
    expected = jacrev(on_cube(model.frf_direct, model, *given))(position)
    assert jacobian_error(jacrev(on_cube(model.frf, model, *given))(position), expected) < AGREEMENT


@pytest.mark.parametrize("cells", [2, pytest.param(3, marks=pytest.mark.check)])
def test_no_gradient_of_5000_random_square_plates_is_nan(plates, cells: int) -> None:
    mesh = Mesh(0.4, 0.4, cells, cells)
    # Corners alike and a light lump in the middle keep the pairs together.
    model = plates.build(
        mesh, None, EVERYTHING, wires=((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)), lump=(0.5, 0.5)
    )
    position = inside(model, 5000, seed=4).requires_grad_()
    value = torch.view_as_real(model.frf(model.space.to_si(position), lines(plates, mesh, 3), [2], [(0.3, 0.8)]))
    (found,) = torch.autograd.grad(value.square().sum(), position)
    assert bool(found.isfinite().all())
    assert bool((found != 0).all())
    some = position[::1000].detach().requires_grad_()
    direct = torch.view_as_real(model.frf_direct(model.space.to_si(some), lines(plates, mesh, 3), [2], [(0.3, 0.8)]))
    (expected,) = torch.autograd.grad(direct.square().sum(), some)
    assert jacobian_error(found[::1000], expected) < AGREEMENT


@pytest.mark.parametrize("mesh", [Mesh(0.48, 0.48, 8, 8), Mesh(0.7, 0.4, 9, 6)], ids=["square", "rectangle"])
@pytest.mark.check
def test_a_reduced_basis_has_exact_gradients_too(plates, mesh: Mesh) -> None:
    known = {key: 0.5 * (EVERYTHING[key].low + EVERYTHING[key].high) for key in list(EVERYTHING)[6:]}
    # A wide box of Poisson's ratio would need more members to build from than a test has time for.
    narrow = {key: EVERYTHING[key] for key in list(EVERYTHING)[:6]} | {"plate.poisson_ratio": Searched(0.295, 0.305)}
    model = plates.build(mesh, known, narrow, response=[3, 14], reference=[8])
    frequency, position = lines(plates, mesh), inside(model, seed=5)
    outcome = reduce(model, frequency)
    assert outcome is not None
    reduced, _ = outcome
    assert reduced.assembly.size < model.assembly.size / 2
    found = jacrev(on_cube(reduced.frf, reduced, frequency))(position)
    assert jacobian_error(found, jacrev(on_cube(reduced.frf_direct, reduced, frequency))(position)) < AGREEMENT
    assert jacobian_error(jacfwd(on_cube(reduced.frf, reduced, frequency))(position), found) < AGREEMENT
    # The basis holds its values to 1e-4; its gradients may be ten times coarser, having no check of their own.
    assert jacobian_error(found, jacrev(on_cube(model.frf_direct, model, frequency))(position)) < 1e-3


def test_a_transmissibility_has_exact_gradients(plates) -> None:
    for mesh in (Mesh(0.5, 0.5, 4, 4, edges={"x0": "clamped"}), Mesh(0.7, 0.4, 5, 4, edges={"y0": "simply_supported"})):
        model = plates.build(
            mesh, {"wires.stiffness": 50.0}, {k: EVERYTHING[k] for k in EVERYTHING if "wires" not in k}
        )
        given = (lines(plates, mesh), [8, 20], None, "transmissibility")
        position = inside(model, seed=6)
        expected = jacrev(on_cube(model.frf_direct, model, *given))(position)
        assert jacobian_error(jacrev(on_cube(model.frf, model, *given))(position), expected) < AGREEMENT


@dataclass(frozen=True)
class ElementField(Effect):
    """Every element of a 4 × 3 mesh has a thickness and a Young's modulus of its own."""

    parameters = {f"{word}_{i}": Parameter("-", "over nominal", neutral=1.0) for word in ("h", "E") for i in range(12)}
    acts_on = frozenset({"section"})
    shows = "Only the tests use it."
    source = "none"

    def section(self, mesh: Mesh, section: Section, value: Mapping[str, torch.Tensor]) -> Section:
        thickness, young = (torch.stack([value[f"{w}_{i}"] for i in range(mesh.n_element)], dim=-1) for w in ("h", "E"))
        return section._replace(thickness=section.thickness * thickness, youngs_modulus=section.youngs_modulus * young)


del CATALOGUE[ElementField.name]


@pytest.mark.parametrize("length_y", [0.48, 0.4], ids=["square", "rectangle"])
def test_a_field_of_thickness_and_modulus_has_exact_gradients(plates, length_y: float) -> None:
    mesh = Mesh(0.48, length_y, 4, 3)
    young, poisson, density = plates.metals["steel"]
    known = {"plate.youngs_modulus": young, "plate.poisson_ratio": poisson, "plate.density": density}
    model = PlateModel(
        mesh,
        {"plate": Plate(), "field": ElementField(), "loss": HystereticDamping()},
        known | {"plate.thickness": 0.003, "loss.stiffness_loss_factor": 0.01},
        {f"field.{name}": Searched(0.8, 1.2) for name in ElementField.parameters},
    )
    given = (lines(plates, mesh), [2, 13], [9])
    for position in (torch.full((24,), 0.5, dtype=torch.float64), inside(model, seed=7)):
        expected = jacrev(on_cube(model.frf_direct, model, *given))(position)
        assert jacobian_error(jacrev(on_cube(model.frf, model, *given))(position), expected) < AGREEMENT


@SHAPES
@pytest.mark.check
def test_vmap_answers_as_a_loop_and_as_a_batch_do(plates, mesh: Mesh) -> None:
    model = plates.build(mesh, None, EVERYTHING)
    frf = on_cube(model.frf, model, lines(plates, mesh), [3, 14], [8])
    position = inside(model, 3, seed=8)
    values = torch.stack([frf(member) for member in position])
    # Rounding at the scale of the highest eigenvalue, in another order.
    torch.testing.assert_close(vmap(frf)(position), values, rtol=1e-8, atol=1e-9 * values.abs().max().item())
    assert (values[0] - values[1]).abs().max() > 1e-2 * values.abs().max()
    loop = torch.stack([jacrev(frf)(member) for member in position])
    for found in (vmap(jacrev(frf))(position), vmap(jacfwd(frf))(position)):
        assert jacobian_error(found, loop) < 1e-7
    whole = jacrev(frf)(position)
    for member in range(3):
        assert jacobian_error(whole[member, ..., member, :], loop[member]) < 1e-7
        others = [other for other in range(3) if other != member]
        assert bool((whole[member][..., others, :] == 0).all())


def test_chunks_of_members_and_lines_change_no_gradient(plates) -> None:
    for mesh in (SQUARE, RECTANGLE):
        found = []
        for memory in (2**30, 1):
            model = plates.build(mesh, None, EVERYTHING, memory=memory)
            position = inside(model, 3, seed=9).requires_grad_()
            value = torch.view_as_real(model.frf(model.space.to_si(position), lines(plates, mesh, 4), [3], [8, 14]))
            found += torch.autograd.grad(value.square().sum(), position)
        assert jacobian_error(found[0], found[1]) < 1e-7


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.check
def test_second_and_third_derivatives_are_exact(plates, loss_field: bool) -> None:
    searched = {k: EVERYTHING[k] for k in EVERYTHING if k not in ("plate.density", "plate.poisson_ratio")}
    searched |= {"field.base": Searched(0.001, 0.1)} if loss_field else {}
    for mesh in (Mesh(0.4, 0.4, 2, 2), Mesh(0.7, 0.4, 3, 2)):
        model = plates.build(mesh, None, searched, loss_field=loss_field)
        position, given = inside(model, seed=10), (lines(plates, mesh, 3), [2, 5], [9])

        def level(evaluate: Callable[..., torch.Tensor], given: tuple = given, model: PlateModel = model) -> Callable:
            return lambda u: on_cube(evaluate, model, *given)(u).square().sum((-4, -3, -2, -1)).log()

        fast, direct = level(model.frf), level(model.frf_direct)
        # Reverse over reverse: forward mode through torch.linalg.solve is not right at second order.
        expected = jacrev(jacrev(direct))(position)
        for found in (hessian(fast), jacrev(jacrev(fast)), jacrev(jacfwd(fast))):
            torch.testing.assert_close(found(position), expected, rtol=1e-6, atol=1e-6 * expected.abs().max().item())
        found, expected = (jacrev(grad(lambda u, f=f: jacrev(f)(u).square().sum()))(position) for f in (fast, direct))
        torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6 * expected.abs().max().item())


def test_forward_mode_inside_forward_mode_is_refused(plates) -> None:
    model = plates.build(SQUARE, None, EVERYTHING)
    frf = on_cube(model.frf, model, lines(plates, SQUARE, 2), [3], [8])
    with pytest.raises(NotImplementedError, match=r"one forward-mode transform.*torch\.func\.hessian"):
        jacfwd(jacfwd(frf))(inside(model, seed=11))


def test_a_gradient_takes_one_eigenproblem_and_differentiates_none(plates, monkeypatch: pytest.MonkeyPatch) -> None:
    sound, seen = torch.linalg.eigh, []

    def eigh(matrix: torch.Tensor, *args: object, **options: object):
        seen.append(matrix.requires_grad)
        return sound(matrix, *args, **options)

    monkeypatch.setattr(torch.linalg, "eigh", eigh)
    for mesh in (SQUARE, RECTANGLE):
        model = plates.build(mesh, None, EVERYTHING)
        position = inside(model, 2, seed=12).requires_grad_()
        model.frf(model.space.to_si(position), lines(plates, mesh), [3], [8]).abs().sum().backward()
    assert seen == [False, False]


def test_a_heavy_point_mass_moves_the_gradient_with_its_place(plates) -> None:
    young, poisson, density = plates.metals["brass"]
    known = {"plate.youngs_modulus": young, "plate.poisson_ratio": poisson, "plate.density": density}
    model = PlateModel(
        RECTANGLE,
        {"plate": Plate(), "loss": HystereticDamping(), "mass": PointMass()},
        known | {"plate.thickness": 0.002, "loss.stiffness_loss_factor": 0.02, "mass.mass": 0.8},
        {"mass.x": Searched(0.0, 1.0), "mass.y": Searched(0.0, 1.0)},
    )
    frequency = lines(plates, RECTANGLE)
    # At x = 1/2 a node line meets two elements; the shape functions have one slope from both sides along it.
    for position in (torch.tensor([0.37, 0.81], dtype=torch.float64), torch.tensor([0.13, 0.29], dtype=torch.float64)):
        found = jacrev(on_cube(model.frf, model, frequency, [3], [8]))(position)
        direct = on_cube(model.frf_direct, model, frequency, [3], [8])
        step = 1e-4
        differences = [
            (direct(position + step * e) - direct(position - step * e)) / (2 * step) for e in torch.eye(2).double()
        ]
        # The step's square, with slopes that change over a tenth of the plate, and rounding over the step.
        assert jacobian_error(found, torch.stack(differences, dim=-1)) < 1e-4
