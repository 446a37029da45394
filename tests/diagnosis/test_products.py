"""Inner products of changes that are never whitened, beside those of changes that are."""

import pytest
import torch

from torchplate.diagnosis.selection.null import drawn
from torchplate.diagnosis.selection.products import Products, best_of_places


def random(*shape: int, seed: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("n_told", [0, 2])
def test_they_are_those_of_whitened_and_freed_changes(lab, n_told):
    marginal = lab.Scene(hidden={"gain": 1.0}).state.fit.marginal
    n = int(marginal.n)
    # Changes that go far along what nuisances do, too.
    change = 5 * random(7, n, seed=1)
    change += marginal.across(3 * random(7, len(marginal.group), seed=2))
    whole = torch.linalg.qr(random(n + n_told, 3, seed=3))[0]
    residual, draws = random(n + n_told, seed=4), drawn(n, n_told)
    left = residual - whole @ (whole.mT @ residual)
    found = Products(marginal, left, whole, draws, n)
    score = found.of(change)

    white = torch.cat([marginal.whitened(change), change.new_zeros(7, n_told)], dim=-1)
    freed = white - white @ whole @ whole.mT
    close = {"rtol": 1e-9, "atol": 1e-9 * float(change.norm())}
    assert torch.allclose(found.freed(change), freed, **close)
    assert torch.allclose(score.along, freed @ left, **close)
    assert torch.allclose(score.known, white @ whole, **close)
    assert torch.allclose(score.size, freed.square().sum(-1), rtol=1e-9)
    fall = (freed @ draws.mT).square() / freed.square().sum(-1)[:, None]
    assert torch.allclose(score.fall, fall, rtol=1e-8, atol=1e-8)
    assert torch.allclose(best_of_places(score), fall.amax(0), rtol=1e-8, atol=1e-8)


def test_what_the_fitted_parameters_can_do_says_nothing_of_chance():
    known, draws = torch.linalg.qr(random(40, 2, seed=1))[0], random(30, 40, seed=2)
    places = torch.cat([known.mT, random(1, 40, seed=3)])
    found = Products(None, random(40, seed=4), known, draws, 40).of(places)
    assert torch.allclose(best_of_places(found), found.fall[2])
