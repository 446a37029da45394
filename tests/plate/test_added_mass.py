"""The lattice of doublets against what is known of fluid around thin plates."""

import math

import pytest
import torch

from torchplate.plate import Mesh
from torchplate.plate.added_mass import POINT_WEIGHT, _points, dragged, influence, interlaced, lattice, panels


def of_translation(length_x: float, length_y: float, n_panel: int = 20) -> float:
    """Added mass of a plate that moves as a whole, over the density [m³]."""
    return float(lattice(length_x, length_y, n_panel)[1].sum())


def test_a_long_strip_drags_a_cylinder_of_its_width():
    # ρ π b² / 4 per length; what the ends lack is the same for both lengths.
    width = 0.13
    middle = of_translation(20 * width, width) - of_translation(10 * width, width)
    assert middle / (10 * width) == pytest.approx(math.pi * width**2 / 4, rel=0.01)


def test_a_disc_drags_eight_thirds_of_its_radius_cubed():
    # Equal panels whose outermost end a quarter of one within the rim, as in a doublet lattice; the rim is staircase,
    # and its error changes sign from size to size: a mean of some.
    radius, found = 0.21, []
    for n in range(36, 50, 2):
        size = 2 * radius / n
        edge = size * torch.arange(n + 1, dtype=torch.float64) - radius
        middle = 0.5 * (edge[1:] + edge[:-1])
        kept = (middle[:, None] ** 2 + middle**2).sqrt().flatten() < radius - size / 4
        own = influence(edge, middle, edge, middle)[kept][:, kept]
        found.append(size**2 * float(torch.linalg.inv(own).sum()))
    assert sum(found) / len(found) == pytest.approx(8 / 3 * radius**3, rel=0.01)


@pytest.mark.parametrize(
    ("ratio", "coefficient"), [(1.0, 0.579), (1.5, 0.690), (2.0, 0.757), (4.0, 0.872), (10.0, 0.947)]
)
def test_rectangles_drag_what_is_tabulated(ratio: float, coefficient: float):
    # Of a cylinder on the short side, three decimals (DNV-RP-H103, Table A-2).
    short = 0.31
    found = of_translation(ratio * short, short) / (math.pi / 4 * short**2 * ratio * short)
    assert found == pytest.approx(coefficient, rel=0.01)
    assert of_translation(short, ratio * short) == pytest.approx(of_translation(ratio * short, short), rel=1e-9)


@pytest.mark.check
@pytest.mark.parametrize("waves", [(0, 0), (2, 0), (1, 1), (3, 2)], ids=str)
def test_it_converges_with_the_square_of_the_panels(waves: tuple[int, int]):
    def energy(n_panel: int) -> float:
        place, coupling = lattice(0.48, 0.4, n_panel)
        waved = torch.cos(math.pi * waves[0] * place[..., 0]) * torch.cos(math.pi * waves[1] * place[..., 1])
        field = waved @ torch.tensor(POINT_WEIGHT, dtype=torch.float64)
        return float(field @ coupling @ field)

    limit = energy(56)
    errors = [abs(energy(n) - limit) / limit for n in (10, 20)]
    # The mass of the air is some hundredth of the plate's: 0.5 % of it are 5e-5 of a natural frequency.
    assert errors[1] < 0.005
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.parametrize("sides", [(0.48, 0.48), (0.58, 0.213), (2.0, 0.1)], ids=str)
def test_every_motion_drags_a_mass(sides: tuple[float, float]):
    coupling = lattice(*sides)[1]
    assert torch.equal(coupling, coupling.mT)
    assert float(torch.linalg.eigvalsh(coupling)[0]) > 0


def test_it_is_made_once_for_a_geometry():
    first, again = dragged(Mesh(0.5, 0.3, 6, 4, refine=2)), dragged(Mesh(0.5, 0.3, 12, 8, edges={"x0": "clamped"}))
    assert first[0] is again[0]
    assert first[1] is again[1]
    assert dragged(Mesh(0.5, 0.31, 12, 8))[1] is not first[1]


def test_two_points_of_a_panel_hold_what_a_cubic_has_over_it():
    edge = torch.tensor([0.1, 0.35, 0.4], dtype=torch.float64)
    _, left, right = _points(edge, torch.zeros(2, dtype=torch.float64))
    for power in (1, 2, 3):
        mean = (edge.pow(power + 1)).diff() / ((power + 1) * edge.diff())
        torch.testing.assert_close(0.5 * (left.pow(power) + right.pow(power)), mean, rtol=1e-12, atol=0.0)


def test_the_air_is_felt_at_the_control_point_of_each_panel_and_at_gauss_s_four():
    sides = (0.58, 0.213)
    place = lattice(*sides, n_panel=12)[0]
    (edge_x, x), (edge_y, y) = (interlaced(1.0, n) for n in panels(*sides, 12))
    # Panels count along x first; places are relative.
    across, along = (one.flatten() for one in torch.meshgrid(y, x, indexing="ij"))
    torch.testing.assert_close(place[:, 0], torch.stack([along, across], dim=-1), rtol=1e-12, atol=1e-15)
    # The mean over a panel of what is linear in x, in y and in both is that of its four other points.
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in (edge_x, edge_y)]
    across, along = (one.flatten() for one in torch.meshgrid(middle[1], middle[0], indexing="ij"))
    four = place[:, 1:]
    torch.testing.assert_close(four.mean(1), torch.stack([along, across], dim=-1), rtol=1e-12, atol=0.0)
    torch.testing.assert_close(four.prod(-1).mean(-1), along * across, rtol=1e-12, atol=0.0)
