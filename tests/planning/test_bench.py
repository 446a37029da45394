"""A hypothesis in its basis is the hypothesis, in every state that is proposed."""

import dataclasses

import pytest
import torch

from torchplate.discrepancy.specimen import Found
from torchplate.planning import Lab
from torchplate.planning.bench import Bench, principal_axes
from torchplate.planning.forthcoming import Forthcoming


@torch.no_grad()
def test_one_basis_serves_every_state(lab):
    twins = lab.twins("support")
    proposals = Lab(n_place=2, shares=(0.06,)).proposals(twins.model, lab.TOLD)
    places = [point for one in proposals for point in (*one.places, *(one.response or ()), *(one.reference or ()))]
    rival = twins.doubt.rivals[1]
    bench = Bench(twins.builder, rival, places)
    whole = rival.model(twins.builder.given)
    theta = whole.space.to_si(rival.position)
    whole = twins.builder.corrected(whole, theta).model
    seen = set()
    for proposal in proposals:
        if proposal.can in seen:
            continue
        seen.add(proposal.can)
        state, full = bench.state(proposal), proposal.state(whole)
        exact = full.frf(bench.in_state(full, bench.here), twins.lines)
        found = state.frf(bench.in_state(state, bench.here), twins.lines)
        # As much as a basis of a diagnosis leaves (`Meshes.rounding`).
        assert float(((found - exact).norm(dim=0) / exact.norm(dim=0)).max()) < 5e-4
    assert seen == {"sensor", "hammer", "mass", "wires", "window"}


@torch.no_grad()
def test_what_is_not_known_of_the_specimen_is_left_open(lab):
    twins = lab.twins("support")
    n = len(twins.bench()[0].specimens.names)
    generator = torch.Generator().manual_seed(6)
    shift = 0.3 * torch.randn(n, generator=generator, dtype=torch.float64)
    root = 0.4 * torch.randn(n, n, generator=generator, dtype=torch.float64) / n**0.5
    spread = root @ root.mT + 0.01 * torch.eye(n, dtype=torch.float64)
    rival = dataclasses.replace(twins.doubt.rivals[0], found=Found(shift, spread))
    bench = Bench(twins.builder, rival, [])
    test = Forthcoming([bench], twins.target, dataclasses.replace(twins.doubt, rivals=(rival,)))
    found = test.specimen(0).abs().square().sum(0)
    theta, step = bench.theta(bench.here), 1e-3
    ends = [
        bench.specimens.at(shift + sign * step * one).frf(theta, twins.lines)
        for one in torch.eye(n, dtype=torch.float64)
        for sign in (1.0, -1.0)
    ]
    slope = (torch.stack(ends[::2]) - torch.stack(ends[1::2])) / (2 * step)
    exact = torch.einsum("kfrq,kl,lfrq->frq", slope.conj(), spread.to(slope), slope).real
    # The columns leave out the damping that couples modes: a part of the order of the loss factor.
    assert float((found - exact).norm() / exact.norm()) < 0.03


def test_axes_of_a_posterior_are_its_square_root():
    precision = torch.tensor([[4e8, 1e3, 0.0], [1e3, 25.0, -3.0], [0.0, -3.0, 12.0]], dtype=torch.float64)
    axes = principal_axes(precision)
    torch.testing.assert_close(axes @ axes.mT @ precision, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-7)


@torch.no_grad()
def test_the_measured_test_again_tells_twins_no_better_than_before(lab):
    """They predict the same, and what either leaves open is as wide for both."""
    twins = lab.twins("support")
    test = Forthcoming(twins.bench(), twins.target, twins.doubt)
    one, other = (test.predicted(k) for k in range(2))
    # But for what two bases leave: a quarter in −2 ln L, of which a name needs six.
    assert float((one.mean - other.mean).norm()) < 0.5
    assert one.n_parameter == len(twins.doubt.rivals[0].position)
    # Noise in the real parts alone makes every second number 1, but for what nuisances take on.
    noise = torch.randn(test.expected.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    white = test.white(noise.to(test.expected) * test.target.variance.sqrt())
    assert float(white.square().mean()) == pytest.approx(0.5, rel=0.2)
