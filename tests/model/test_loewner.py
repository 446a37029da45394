"""Divided differences of what is known of a function at every mode, where modes are apart, close and the same."""

import pytest
import torch

from torchplate.model.receptance.loewner import _Divided


@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-8, 1e3], ids=str)
def test_modes_that_rounding_alone_tells_apart_have_the_derivative(apart: float) -> None:
    """S_ab(λ) = 1 / (z_ab − λ), whose divided difference is 1 / ((z_ab − λ) (z_ab − λ')), λ as large as rad²/s² are."""
    eigenvalue = torch.tensor([2.1e6, 2.1e6 + apart, 5.7e6], dtype=torch.float64)
    generator = torch.Generator().manual_seed(2)
    rows, columns = (torch.randn(n, 3, generator=generator, dtype=torch.float64) for n in (2, 4))
    z = 1e7 + 1e6 * torch.rand(2, 4, generator=generator, dtype=torch.float64)
    each = 1 / (z[..., None] - eigenvalue)  # [row, column, mode]
    nearest = (z.amin() - eigenvalue).abs()
    first, second = (each * rows[:, None]).sum(0), (each * columns).sum(1)
    of_first, of_second = (each.square() * rows[:, None]).sum(0), (each.square() * columns).sum(1)
    found = _Divided(eigenvalue, nearest, rows, columns)(first, second, of_first, of_second)
    expected = torch.einsum("ai,abi,abj,bj->ij", rows, each, each, columns)
    # A difference of neighbours loses 1e-16 / 1e-5 of itself; 1e3 apart it loses less.
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-10 * float(expected.abs().max()))
