"""Elements that the edges of a patch cut: beams of two parts, and integrals over what is covered."""

import numpy as np
import pytest
import torch

from torchplate.effects import GrainAngle, Orthotropy, Plate, Searched, StiffnessLoss
from torchplate.model import PlateModel
from torchplate.plate import Mesh, element, patch

NONE = torch.zeros(0, dtype=torch.float64)
STEEL = {"plate.youngs_modulus": 205e9, "plate.density": 7850.0, "plate.thickness": 0.002}


def _stiffness(mesh: Mesh, known: dict[str, float], turned: bool = False, nu: float = 0.3) -> torch.Tensor:
    """K of a plate with a patch, in all dofs."""
    effects, values = {"plate": Plate(), "patch": StiffnessLoss()}, STEEL | {"plate.poisson_ratio": nu}
    if turned:
        effects |= {"wood": Orthotropy(), "grain": GrainAngle()}
        values |= {"wood.young_ratio": 0.1, "wood.shear_factor": 0.7, "grain.angle": 0.3}
    model = PlateModel(mesh, effects, values | {f"patch.{name}": value for name, value in known.items()})
    return model.assembly.system(*model.plan(NONE)).stiffness


def test_a_rigidity_that_is_the_same_all_over_an_element_has_the_patterns_of_the_mean() -> None:
    a, b = 0.3, 0.2
    over = torch.tensor([1.0, 0.0, 1 / 12, 0.0, 1 / 80], dtype=torch.float64)
    found = torch.einsum("kpqab,p,q->kab", element.uneven_patterns(a, b).unflatten(1, (5, 5)), over, over)
    expected = element.patterns(a, b).stiffness
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12 * float(expected.abs().max()))


def _beam(rigidity: float, length: float) -> np.ndarray:
    """Stiffness of a beam in w and dw/dx at both ends."""
    l = length  # noqa: E741
    return (
        rigidity
        / l**3
        * np.array([[12, 6 * l, -12, 6 * l], [6 * l, 4 * l**2, -6 * l, 2 * l**2], [-12, -6 * l, 12, -6 * l],
                    [6 * l, 2 * l**2, -6 * l, 4 * l**2]])
    )  # fmt: skip


@pytest.mark.parametrize("factor", [0.2, 0.7, 1.4])
@pytest.mark.parametrize("part", [0.15, 0.6])
@pytest.mark.parametrize("along", ["x", "y"])
def test_an_element_cut_across_is_a_beam_of_two_parts(factor: float, part: float, along: str) -> None:
    length, width = 0.3, 0.5
    sides = (length, width) if along == "x" else (width, length)
    # Over the whole of one side, and from beyond one end over a part of the other.
    stretch = 4 / 3 * part * length / (1.2 * width)
    patch = {"x": part / 3, "y": 0.5} if along == "x" else {"x": 0.5, "y": part / 3}
    aspect = stretch if along == "x" else 1 / stretch
    size = (4 / 3 * part * 1.2) ** 0.5
    found = _stiffness(Mesh(*sides, 1, 1), patch | {"size": size, "aspect": aspect, "factor": factor}, nu=0.0)
    # A mesh's dofs are w, ∂w/∂(y/Ly) and −∂w/∂(x/Lx), of nodes along x first.
    motion = torch.zeros(12, 4, dtype=torch.float64)
    for node, (x, y) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        end = x if along == "x" else y
        motion[3 * node, 2 * end] = 1.0
        motion[3 * node + (2 if along == "x" else 1), 2 * end + 1] = -length if along == "x" else length
    bending = width * 205e9 * 0.002**3 / 12
    whole = np.zeros((6, 6))
    whole[:4, :4] += _beam(factor * bending, part * length)
    whole[2:, 2:] += _beam(bending, (1 - part) * length)
    ends, middle = [0, 1, 4, 5], [2, 3]
    inner = np.linalg.solve(whole[np.ix_(middle, middle)], whole[np.ix_(middle, ends)])
    expected = torch.from_numpy(whole[np.ix_(ends, ends)] - whole[np.ix_(ends, middle)] @ inner)
    torch.testing.assert_close(motion.mT @ found @ motion, expected, rtol=0, atol=1e-9 * float(expected.abs().max()))


@pytest.mark.parametrize("turned", [False, True], ids=["straight", "turned"])
def test_a_little_less_stiffness_takes_the_energy_under_the_patch(turned: bool) -> None:
    mesh, step = Mesh(0.6, 0.4, 3, 2), 1e-5
    patch = {"x": 0.37, "y": 0.56, "size": 0.45, "aspect": 1.3}
    less, more = (_stiffness(mesh, patch | {"factor": 1 + sign * step}, turned) for sign in (-1, 1))
    slope = (more - less) / (2 * step)
    motion = torch.randn(mesh.n_dof, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    # ∫ κᵀDκ over the rectangle, by Gauss points in each part of it that lies in one element.
    d11, d22, d12 = (205e9 * 0.002**3 / 12 / (1 - 0.3**2) * part for part in (1.0, 1.0, 0.3))
    d33 = 205e9 * 0.002**3 / 12 / (2 * 1.3)
    rigidity = torch.tensor([[d11, d12, 0], [d12, d22, 0], [0, 0, d33]], dtype=torch.float64)
    if turned:
        rigidity[0, 0], rigidity[1, 1], rigidity[2, 2] = d11 / 0.1**0.5, d22 * 0.1**0.5, 0.7 * d33
        c, s = np.cos(0.3), np.sin(0.3)
        turn = torch.tensor(
            [[c**2, s**2, c * s], [s**2, c**2, -c * s], [-2 * c * s, 2 * c * s, c**2 - s**2]], dtype=torch.float64
        )
        rigidity = turn.mT @ rigidity @ turn
    wide, high = 0.45 * (0.24 * 1.3) ** 0.5, 0.45 * (0.24 / 1.3) ** 0.5
    x0, x1, y0, y1 = 0.37 * 0.6 - wide / 2, 0.37 * 0.6 + wide / 2, 0.56 * 0.4 - high / 2, 0.56 * 0.4 + high / 2
    point, weight = np.polynomial.legendre.leggauss(4)
    energy, a, b = 0.0, 0.2, 0.2
    scale = torch.tensor([1.0, 1 / 0.4, 1 / 0.6], dtype=torch.float64).repeat(4)
    for (column, row), dofs in zip(((i, j) for j in range(2) for i in range(3)), mesh.element_dof, strict=True):
        left, right = max(x0, column * a), min(x1, (column + 1) * a)
        low, top = max(y0, row * b), min(y1, (row + 1) * b)
        if left >= right or low >= top:
            continue
        own = motion[dofs] * scale
        for p, u in zip(point, weight, strict=True):
            for q, v in zip(point, weight, strict=True):
                at = [(left + (right - left) * (p + 1) / 2) / a - column, (low + (top - low) * (q + 1) / 2) / b - row]
                place = torch.tensor(at, dtype=torch.float64)
                bent = [element.shape_functions(place, a, b, *order) @ own for order in ((2, 0), (0, 2), (1, 1))]
                curvature = torch.stack([-bent[0], -bent[1], -2 * bent[2]])
                energy += float(curvature @ rigidity @ curvature) * u * v * (right - left) * (top - low) / 4
    assert float(motion @ slope @ motion) == pytest.approx(energy, rel=1e-7)


def test_members_with_patches_in_their_own_places_are_each_as_alone() -> None:
    mesh, effects = Mesh(0.5, 0.4, 6, 5), {"plate": Plate(), "patch": StiffnessLoss()}
    known = STEEL | {"plate.poisson_ratio": 0.3, "patch.factor": 0.4, "patch.size": 0.22}
    places = torch.tensor([[0.3, 0.4], [0.71, 0.55], [0.05, 0.9]], dtype=torch.float64)
    names = {"patch.x": Searched(0.0, 1.0), "patch.y": Searched(0.0, 1.0)}
    model = PlateModel(mesh, effects, known, names)
    basis = torch.randn(len(mesh.free_dof), 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    whole = model.assembly.system(*model.plan(places)).stiffness
    for one, place in zip(whole, places, strict=True):
        torch.testing.assert_close(one, model.assembly.system(*model.plan(place)).stiffness, rtol=1e-12, atol=1e-6)
    seen = model.projected(basis)
    projected = basis.mT @ whole @ basis
    found = seen.assembly.system(*seen.plan(places)).stiffness
    torch.testing.assert_close(found, projected, rtol=0, atol=1e-10 * float(projected.abs().max()))
    hidden = torch.vmap(lambda place: seen.assembly.system(*seen.plan(place)).stiffness)(places)
    torch.testing.assert_close(hidden, projected, rtol=0, atol=1e-10 * float(projected.abs().max()))


@pytest.mark.parametrize("cut", [(), ((0.0, 0.0, 0.25, 0.5),)])
def test_patches_at_places_far_apart_are_what_each_is_alone(cut: tuple[tuple[float, ...], ...]) -> None:
    """Elements that no member's patch reaches are left out where somebody may look: one lies off the plate."""
    mesh = Mesh(0.5, 0.4, 8, 6, cut=cut)
    x, y = (torch.tensor(place, dtype=torch.float64) for place in ([0.2, 0.83, 0.5, -3.0], [0.71, 0.9, 0.55, 0.5]))
    size, factor = torch.full_like(x, 0.17), torch.tensor([0.2 + 0.1j, 0.5, 1.7, 0.4])

    def uneven(x: torch.Tensor, y: torch.Tensor, size: torch.Tensor, factor: torch.Tensor) -> torch.Tensor:
        return patch.uneven_bending(mesh, *mesh.outline(x, y, size, 1.3), factor, torch.full_like(x, 0.3)[..., None])

    together = uneven(x, y, size, factor)
    alone = torch.stack([uneven(*each) for each in zip(x, y, size, factor, strict=True)])
    everywhere = uneven(x.clone().requires_grad_(), y, size, factor)
    # Vectors of complex numbers and those that are left over round differently.
    torch.testing.assert_close(together, alone, rtol=0, atol=1e-16)
    torch.testing.assert_close(together, everywhere.detach(), rtol=0, atol=1e-16)
    assert together[:3].abs().amax((-1, -2, -3)).min() > 1e-3
    assert not bool(together[3].any())
