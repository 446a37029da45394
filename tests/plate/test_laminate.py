"""Elements that the edges of a patch cut: layers in series, by the mechanics of two strips."""

import pytest
import torch

from torchplate.plate import laminate


def told(*numbers: complex) -> torch.Tensor:
    return torch.tensor(numbers, dtype=torch.complex128)


def two_strips(factor: complex, part: float, nu: float) -> list[complex]:
    """D₁₁, D₂₂, D₁₂ and D₃₃ of a strip of the patch beside a sound one, cut across x, over the sound ones.

    M_x is the same in both and κ_y is, too: M_x = d (κ_x + ν κ_y) gives κ_x of each, whose mean is the element's, and
    M_y = d (κ_y + ν κ_x). Solved here for κ of the element of (1, 0) and (0, 1).
    """
    strips = ((part, factor), (1 - part, 1.0))
    found = []
    for kappa_x, kappa_y in ((1.0, 0.0), (0.0, 1.0)):
        moment = (kappa_x + nu * kappa_y) / sum(share / d for share, d in strips)
        each = [(share, d, moment / d - nu * kappa_y) for share, d in strips]
        assert sum(share * own for share, _, own in each) == pytest.approx(kappa_x)
        found.append((moment, sum(share * d * (kappa_y + nu * own) for share, d, own in each)))
    # The sound element has 1, 1, ν in the same units; twist is shared as stiffnesses are.
    return [found[0][0], found[1][1], found[1][0] / nu, part * factor + 1 - part]


@pytest.mark.parametrize("factor", [0.3, 2.4, 1 + 0.2j])
@pytest.mark.parametrize("part", [0.13, 0.71])
@pytest.mark.parametrize("nu", [0.21, 0.44])
def test_an_element_cut_by_one_edge_is_two_strips_beside_each_other(factor: complex, part: float, nu: float) -> None:
    expected = told(*two_strips(factor, part, nu))
    # The whole side along y lies under the patch.
    across_x = laminate(told(factor), told(part), told(1.0), told(nu))[0]
    turned = laminate(told(factor), told(1.0), told(part), told(nu))[0][[1, 0, 2, 3]]
    for found in (across_x, turned):
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=0)


def test_a_cut_corner_lies_between_the_series_and_the_mean() -> None:
    factor, x, y, nu = 0.35, 0.4, 0.7, 0.3
    found = laminate(told(factor), told(x), told(y), told(nu))[0].real
    covered = x * y
    series, mean = 1 / (1 + covered * (1 / factor - 1)), 1 + covered * (factor - 1)
    assert bool((found > series - 1e-12).all())
    assert bool((found < mean + 1e-12).all())
    bending = torch.tensor([[found[0], nu * found[2]], [nu * found[2], found[1]]])
    assert float(torch.linalg.eigvalsh(bending).min()) > 0


def test_what_is_not_weaker_is_the_sound_element() -> None:
    found = laminate(told(1.0), told(0.3), told(0.8), told(0.33))[0]
    torch.testing.assert_close(found, torch.ones_like(found), rtol=1e-14, atol=0)
