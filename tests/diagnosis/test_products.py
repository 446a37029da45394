"""Inner products of changes that are never whitened, beside those of changes that are."""

import gc

import pytest
import torch

from torchplate.diagnosis.selection.null import Draws
from torchplate.diagnosis.selection.products import AT_ONCE, Products, best_of_places, most_of_the_mesh


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
    residual, draws = random(n + n_told, seed=4), Draws(n, n_told)
    left = residual - whole @ (whole.mT @ residual)
    mesh = 3 * random(n, seed=5)
    found = Products(marginal, left, whole, draws, n, mesh)
    score = found.of(change)

    white = torch.cat([marginal.whitened(change), change.new_zeros(7, n_told)], dim=-1)
    freed = white - white @ whole @ whole.mT
    close = {"rtol": 1e-9, "atol": 1e-9 * float(change.norm())}
    assert torch.allclose(found.freed(change), freed, **close)
    assert torch.allclose(score.along, freed @ left, **close)
    assert torch.allclose(score.known, white @ whole, **close)
    assert torch.allclose(score.size, freed.square().sum(-1), rtol=1e-9)
    (every,) = draws.split(len(draws))
    fall = (freed @ every.mT).square() / freed.square().sum(-1)[:, None]
    assert torch.allclose(score.fall, fall, rtol=1e-8, atol=1e-8)
    assert torch.allclose(best_of_places(score), fall.amax(0), rtol=1e-8, atol=1e-8)
    # What a mesh may have left is whitened and freed like a change.
    white_mesh = torch.cat([marginal.whitened(mesh), mesh.new_zeros(n_told)])
    along = freed @ (white_mesh - whole @ (whole.mT @ white_mesh))
    assert torch.allclose(score.mesh, along, **close)
    assert most_of_the_mesh(score) == pytest.approx(float((along.square() / freed.square().sum(-1)).max()))
    assert not Products(marginal, left, whole, draws, n).of(change).mesh.any()


def test_what_the_fitted_parameters_can_do_says_nothing_of_chance():
    known, draws = torch.linalg.qr(random(40, 2, seed=1))[0], Draws(40, n_draw=30)
    places = torch.cat([known.mT, random(1, 40, seed=3)])
    found = Products(None, random(40, seed=4), known, draws, 40).of(places)
    assert torch.allclose(best_of_places(found), found.fall[2])


def test_draws_are_whitened_a_few_at_a_time_and_come_out_as_all_at_once(lab, monkeypatch):
    """Whitening takes several times the memory of what it whitens: of all draws of many FRFs that is gigabytes."""
    marginal = lab.Scene(hidden={"gain": 1.0}).state.fit.marginal
    n = int(marginal.n)
    known, draws, change = torch.linalg.qr(random(n, 3, seed=3))[0], Draws(n), random(5, n, seed=1)
    left, asked = random(n, seed=4), []
    whitened = Products.whitened
    monkeypatch.setattr(Products, "whitened", lambda own, rows: (asked.append(len(rows)), whitened(own, rows))[1])
    found = Products(marginal, left, known, draws, n).of(change)
    # What is left, what a mesh may have left and what the fitted parameters can do come first.
    assert asked[0] == 1 + 1 + 3
    assert sum(asked[1:]) == len(draws) > AT_ONCE
    assert max(asked) <= AT_ONCE
    monkeypatch.setattr("torchplate.diagnosis.selection.products.AT_ONCE", len(draws))
    whole = Products(marginal, left, known, draws, n).of(change)
    assert torch.allclose(found.fall, whole.fall, rtol=1e-9, atol=1e-12)
    assert torch.equal(found.along, whole.along)


@pytest.mark.check
def test_no_draw_is_kept_beside_what_it_is_whitened_to(lab, monkeypatch, collect):
    """Of 121 FRFs two hundred draws are 274 MiB: while they are scored, memory grows by one row for each."""
    marginal = lab.Scene(hidden={"gain": 1.0}).state.fit.marginal
    n, whitened, peaks = int(marginal.n), Products.whitened, {}
    left, change = random(n, seed=4), random(5, n, seed=1)

    def counted(own: Products, rows: torch.Tensor) -> torch.Tensor:
        collect()
        peaks[n_draw] = max(peaks.get(n_draw, 0), live_bytes())
        return whitened(own, rows)

    monkeypatch.setattr(Products, "whitened", counted)
    for n_draw in (10 * AT_ONCE, 30 * AT_ONCE):
        score = Products(marginal, left, left.new_zeros(n, 0), Draws(n, n_draw=n_draw), n).of(change)
        assert score.drawn.shape == (5, n_draw)
    few, many = peaks.values()
    # Some rows are in hand for a moment.
    assert many - few < (20 * AT_ONCE + AT_ONCE) * n * 8


def live_bytes() -> int:
    """Of all tensors that Python sees and that the test has made, each storage once."""
    every = [one for one in gc.get_objects() if type(one) is torch.Tensor]
    return sum({one.untyped_storage().data_ptr(): one.untyped_storage().nbytes() for one in every}.values())
