"""Derivatives of natural frequencies, where they repeat, where they do not, and where they are zero."""

import pytest
import torch
from torch.func import jacfwd, jacrev, vmap

from torchplate.effects import Plate, PointMass
from torchplate.model import PlateModel, Searched
from torchplate.model.receptance.modes import natural_frequencies
from torchplate.plate import Mesh

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")

INTERVALS = {
    "plate.youngs_modulus": Searched(6e10, 8e10),
    "plate.poisson_ratio": Searched(0.25, 0.35),
    "plate.density": Searched(2500.0, 2900.0),
    "plate.thickness": Searched(0.0028, 0.0033),
    "wires.stiffness": Searched(1e3, 2e4),
    "lump.mass": Searched(0.01, 0.2),
}


def on_cube(model: PlateModel, n_mode: int):
    return lambda position: model.natural_frequencies(model.space.to_si(position), n_mode)


def differences(evaluate, position: torch.Tensor, step: float) -> torch.Tensor:
    columns = [
        (evaluate(position + step * e) - evaluate(position - step * e)) / (2 * step)
        for e in torch.eye(len(position)).double()
    ]
    return torch.stack(columns, dim=-1)


def loaded(plates, mesh: Mesh, at: tuple[float, float]) -> PlateModel:
    """A free plate with a point mass of 0 at a place."""
    young, poisson, density = plates.metals["steel"]
    known = {"plate.youngs_modulus": young, "plate.poisson_ratio": poisson, "plate.density": density}
    known |= {"plate.thickness": 0.003, "mass.x": at[0], "mass.y": at[1]}
    return PlateModel(mesh, {"plate": Plate(), "mass": PointMass()}, known, {"mass.mass": Searched(0.0, 1.0)})


def test_natural_frequencies_have_the_gradients_of_central_differences(plates) -> None:
    mesh = Mesh(0.7, 0.4, 5, 4)
    model = plates.build(mesh, None, INTERVALS)
    evaluate, position = on_cube(model, 12), torch.linspace(0.2, 0.9, 6, dtype=torch.float64)
    found = jacrev(evaluate)(position)
    # The step's square times a tenth of the frequency, and rounding over the step: 1e-6 and less.
    torch.testing.assert_close(found, differences(evaluate, position, 1e-3), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(jacfwd(evaluate)(position), found, rtol=1e-8, atol=1e-8)
    several = torch.stack([position, 1 - position])
    expected = torch.stack([jacrev(evaluate)(member) for member in several])
    torch.testing.assert_close(vmap(jacrev(evaluate))(several), expected, rtol=1e-8, atol=1e-8)


def test_a_square_plate_has_finite_gradients_and_right_sums_over_its_pairs(plates) -> None:
    model = plates.build(Mesh(0.4, 0.4, 5, 5), None, {k: INTERVALS[k] for k in list(INTERVALS)[:4]})
    evaluate, position = on_cube(model, 20), torch.tensor([0.3, 0.6, 0.8, 0.4], dtype=torch.float64)
    for found in (jacrev(evaluate)(position), jacfwd(evaluate)(position)):
        assert bool(found.isfinite().all())
        # A change of the whole plate keeps its pairs, so here the single members are right too; rigid-body modes stay.
        expected = differences(evaluate, position, 1e-3)
        torch.testing.assert_close(found[3:], expected[3:], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("at", [(0.31, 0.12), (0.87, 0.44)])
def test_where_a_pair_parts_its_sum_is_right_and_its_members_lie_between_the_branches(plates, at: tuple) -> None:
    model = loaded(plates, Mesh(0.4, 0.4, 6, 6), at)
    evaluate, none = on_cube(model, 20), torch.zeros(1, dtype=torch.float64)
    frequency = evaluate(none)
    pairs = [r for r in range(3, 19) if (frequency[r + 1] - frequency[r]) < 1e-6 * frequency[r]]
    assert len(pairs) >= 3
    found = jacrev(evaluate)(none)[:, 0]
    # To one side only, a mass being at least 0: the step over the plate's mass, 3.8 kg, is the error.
    step = 1e-5
    branches = (evaluate(none + step) - frequency) / step
    for r in pairs:
        both = slice(r, r + 2)
        slope = branches[both].sum()
        assert slope < -0.1
        torch.testing.assert_close(found[both].sum(), slope, rtol=1e-3, atol=0)
        low, high = branches[both].min(), branches[both].max()
        # The branches are apart: one has the mass on its node line.
        assert high - low > 0.5 * slope.abs()
        margin = 1e-3 * slope.abs()
        assert bool(((low - margin <= found[both]) & (found[both] <= high + margin)).all())


def test_on_a_rectangle_a_single_member_has_the_slope_of_its_branch(plates) -> None:
    model = loaded(plates, Mesh(0.5, 0.3, 6, 5), (0.31, 0.12))
    evaluate, none = on_cube(model, 12), torch.zeros(1, dtype=torch.float64)
    step = 1e-5
    expected = (evaluate(none + step) - evaluate(none)) / step
    torch.testing.assert_close(jacrev(evaluate)(none)[3:, 0], expected[3:], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("length_y", [0.4, 0.25], ids=["square", "rectangle"])
def test_rigid_body_modes_have_a_gradient_that_is_finite_and_small(plates, length_y: float) -> None:
    model = plates.build(Mesh(0.4, length_y, 4, 4), None, {k: INTERVALS[k] for k in list(INTERVALS)[:4]})
    position = torch.tensor([[0.3, 0.6, 0.8, 0.4], [0.9, 0.1, 0.2, 0.5]], dtype=torch.float64, requires_grad=True)
    frequency = on_cube(model, 6)(position)
    (found,) = torch.autograd.grad(frequency[:, :3].sum(), position, retain_graph=True)
    (bending,) = torch.autograd.grad(frequency[:, 3:].sum(), position)
    assert bool(found.isfinite().all())
    # As small as the frequencies themselves, which rounding leaves at 1e-4 of the first bending mode or less.
    assert found.abs().max() < 1e-2 * bending.abs().max()


def test_a_frequency_of_zero_or_below_has_gradient_zero() -> None:
    eigenvalue = torch.tensor([-3e-7, 0.0, 4.0, 0.09], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(natural_frequencies(eigenvalue).sum(), eigenvalue)
    expected = torch.tensor([0.0, 0.0, 0.25, 0.5 / 0.3], dtype=torch.float64) / (2 * torch.pi)
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=0)
