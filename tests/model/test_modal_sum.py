"""Far modes as one series, and terms attached one after the other: both against plain sums and solves."""

import cmath

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchplate.model.receptance.attach import attach
from torchplate.model.receptance.modal_sum import (
    EXACT,
    Disc,
    Stretch,
    chebyshev_series,
    chebyshev_values,
    modal_sum,
    reciprocal,
)

N_MODE = 50


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def plain(eigenvalue, left, right, z):
    """Σ left right / (λ − z), as it is written: [n_left, n_right, *batch, n_frequency]."""
    inverse = 1 / (eigenvalue[..., None, :] - z[..., None])
    whole = torch.einsum("...jr,...kr,...fr->...fjk", left.to(z), right.to(z), inverse)
    return whole.movedim((-2, -1), (0, 1))


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
@pytest.mark.parametrize("own_modes", [False, True], ids=["modes of all", "modes of each"])
@pytest.mark.parametrize(("low", "high"), [(0.0, 9e3), (4e3, 5e3), (2e5, 3e5)], ids=["lowest", "inside", "beyond"])
def test_the_sum_is_that_of_all_modes(batch, own_modes, low, high) -> None:
    modes = batch if own_modes else ()
    # Two modes at zero, two equal ones: a free plate, a square one.
    eigenvalue = (6e1 * torch.arange(N_MODE, dtype=torch.float64) ** 2 * (1 + random(*modes, 1, seed=1))).clone()
    eigenvalue[..., 1], eigenvalue[..., 5] = 0.0, eigenvalue[..., 4]
    left, right = random(*modes, 2, N_MODE, seed=2) - 0.5, random(*modes, 4, N_MODE, seed=3) - 0.4
    x = low + (high - low) * random(*batch, 50, seed=4)
    z = torch.complex(x, -1e-3 * x - 1.0)
    found, expected = modal_sum(eigenvalue, left, right, z), plain(eigenvalue, left, right, z)
    assert found.shape == (2, 4, *batch, 50)
    # 3^-32 = 5e-16 of what a far mode adds: rounding is all there is.
    assert float((found - expected).abs().max() / expected.abs().max()) < 1e-13
    quick = modal_sum(eigenvalue, left, right, z, Stretch.around(Disc.around(z, eigenvalue), eigenvalue, 4))
    # Fewer terms are worse, but hardly by more than 3^-4: the series is in use, and falls as it should.
    far = float((quick - expected).abs().max() / expected.abs().max())
    assert far < 3.0**-4


def test_far_modes_are_in_the_series(monkeypatch) -> None:
    eigenvalue, row = torch.tensor([1.0, 50.0, 1e3], dtype=torch.float64), torch.ones(1, 3, dtype=torch.float64)
    z = torch.complex(torch.linspace(40, 60, 9, dtype=torch.float64), torch.full((9,), -0.1, dtype=torch.float64))
    without = modal_sum(eigenvalue[1:2], row[:, :1], row[:, :1], z)
    with_all = modal_sum(eigenvalue, row, row, z)
    # Beside the near mode, 1 / (1 − z) and 1 / (1000 − z).
    added = (1 / (1.0 - z) + 1 / (1e3 - z)).squeeze()
    torch.testing.assert_close((with_all - without).squeeze(), added, rtol=1e-9, atol=1e-12)


@given(st.floats(1.2, 1e6), st.booleans(), st.floats(-1, 1), st.floats(-0.1, 0.1))
def test_the_series_is_the_pole_it_stands_for(a: float, below: bool, x: float, y: float) -> None:
    pole = torch.tensor([-a if below else a], dtype=torch.float64)
    t = torch.complex(torch.tensor(x, dtype=torch.float64), torch.tensor(y, dtype=torch.float64))[None]
    values = torch.stack(chebyshev_values(t, 60))
    found = (chebyshev_series(pole, 60).to(t) @ values).squeeze()
    expected = (1 / (pole - t)).squeeze()

    def rho(z: complex) -> float:
        root = cmath.sqrt(z * z - 1)
        return max(abs(z + root), abs(z - root))

    # 1 / (a − t) has the coefficients 2 ρ(a)^-n / √(a² − 1), and |T_n(t)| ≤ ρ(t)^n: what comes after sixty terms.
    part = rho(complex(t)) / rho(a)
    left = 2 / (a * a - 1) ** 0.5 * part**60 / (1 - part)
    assert abs(complex(found - expected)) < left + 1e-12 * abs(complex(expected))


def test_each_term_of_the_series_takes_off_its_part() -> None:
    t = torch.complex(torch.linspace(-1, 1, 101, dtype=torch.float64), torch.zeros(101, dtype=torch.float64))
    pole = torch.tensor([2.125], dtype=torch.float64)  # ρ = 4
    errors = []
    for n in (4, 8, EXACT):
        found = chebyshev_series(pole, n).to(t) @ torch.stack(chebyshev_values(t, n))
        errors.append(float((found - 1 / (pole - t)).abs().max()))
    for error, n in zip(errors, (4, 8, EXACT), strict=True):
        # 2 / √(a² − 1) · ρ⁻ⁿ / (1 − 1/ρ) is the sum of what is left out.
        assert error == pytest.approx(2 / (2.125**2 - 1) ** 0.5 * 4.0**-n / 0.75, rel=0.05)


@pytest.mark.parametrize("n_term", [0, 1, 4])
@pytest.mark.parametrize("batch", [(), (3,)], ids=str)
def test_attached_terms_are_those_of_the_whole_matrix(n_term: int, batch) -> None:
    n, n_left, n_right = 9, n_term + 2, n_term + 3
    flexible = random(n, n, seed=5) + 1j * random(n, n, seed=6)
    flexible = flexible + flexible.mT + 5 * torch.eye(n)
    rows = random(n_term + 5, n, seed=7) - 0.5
    left, right = rows[: n_term + 2], torch.cat([rows[:n_term], rows[n_term + 2 :]])
    stiffness = (random(n_term, *batch, 6, seed=8) - 0.3) + 1j * random(n_term, *batch, 6, seed=9)
    alone = (left.to(flexible) @ flexible @ right.mT.to(flexible))[..., None].expand(n_left, n_right, 6)
    alone = alone.reshape(n_left, n_right, *(1,) * len(batch), 6).expand(n_left, n_right, *batch, 6)
    found = attach(alone, stiffness)
    tied = rows[:n_term].to(flexible)
    whole = torch.linalg.inv(flexible) + torch.einsum("tn,t...,tm->...nm", tied, stiffness, tied)
    expected = left[n_term:].to(whole) @ torch.linalg.inv(whole) @ right[n_term:].mT.to(whole)
    torch.testing.assert_close(found.movedim((0, 1), (-2, -1)), expected, rtol=1e-9, atol=1e-12)


def stretch_of(n_term: int) -> tuple[torch.Tensor, torch.Tensor, Stretch]:
    eigenvalue = 6e1 * torch.arange(N_MODE, dtype=torch.float64) ** 2
    x = torch.linspace(4e3, 9e3, 30, dtype=torch.float64)
    z = torch.complex(x, -2e-2 * x)
    stretch = Stretch.around(Disc.around(z, eigenvalue), eigenvalue, n_term)
    assert 0 < stretch.first < stretch.last < N_MODE
    return eigenvalue, z, stretch


def test_the_slopes_of_the_series_are_its_derivative_in_the_pole() -> None:
    eigenvalue, z, stretch = stretch_of(EXACT)
    values = torch.stack(chebyshev_values((z - stretch.disc.centre) / stretch.disc.half, EXACT))
    found = stretch.slopes(eigenvalue).to(values) @ values
    expected = -1 / (eigenvalue[:, None] - z) ** 2
    near = slice(stretch.first, stretch.last)
    assert not found[near].any()
    found[near] = expected[near]
    assert float(((found - expected).abs() / expected.abs()).max()) < 1e-9


@pytest.mark.parametrize("n_term", [6, EXACT, N_MODE])
def test_the_slope_of_the_features_is_their_derivative_in_z(n_term: int) -> None:
    if n_term == N_MODE:
        # All are near.
        eigenvalue, z, _ = stretch_of(EXACT)
        stretch = Stretch.around(Disc.around(z, eigenvalue), eigenvalue, n_term)
        assert stretch.series is None
    else:
        eigenvalue, z, stretch = stretch_of(n_term)
    feature = stretch.features(eigenvalue, z)
    weight = torch.complex(random(*feature.shape, seed=11), random(*feature.shape, seed=12))
    order = stretch.sloped(torch.ones(1, len(feature), dtype=torch.float64)).mT
    found = stretch.slope(feature, weight * order, z)
    step = 1e-5 * z.real.max()
    ends = [(weight * stretch.features(eigenvalue, z + sign * step)).sum(0) for sign in (1, -1)]
    torch.testing.assert_close(found, (ends[0] - ends[1]) / (2 * step), rtol=1e-4, atol=1e-5 * float(found.abs().max()))


def test_a_reciprocal_is_torchs_own() -> None:
    value = torch.complex(random(9, seed=13) - 0.5, random(9, seed=14) - 0.5)
    torch.testing.assert_close(reciprocal(value), 1 / value, rtol=1e-14, atol=0)
