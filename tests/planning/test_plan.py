"""The test that is proposed tells which of two names is right; what cannot tell them is not proposed."""

import dataclasses

import pytest
import torch

from torchplate.planning import Lab, plan
from torchplate.planning.forthcoming import Forthcoming
from torchplate.planning.refit import posterior, refitted

# What parts each pair, and a kind of test that does not.
PARTS = {"level": ("mass", "sensor"), "support": ("wires", "hammer"), "damping": ("window", "sensor")}


@pytest.fixture(scope="module", params=sorted(PARTS))
def planned(lab, request):
    """A pair, and what is planned for it."""
    twins = lab.twins(request.param)
    room = Lab(PARTS[request.param], n_place=1, shares=(0.03,))
    found = plan(twins.model, twins.measurement, [twins.doubt], lab=room, imperfections=lab.TOLD, settings=lab.COARSE)
    return request.param, twins, found


@pytest.mark.check
def test_what_parts_twins_is_proposed(planned):
    pair, twins, found = planned
    parting, useless = PARTS[pair]
    assert found.needed
    assert found.proposed.proposal.can == parting
    assert found.proposed.probability > 0.95
    assert found.proposed.says == " | ".join(one.name for one in twins.doubt.rivals)
    # Other places say no more than the first test did; a coin would be as good.
    others = [one for one in found.scored if one.proposal.can == useless]
    assert others
    assert max(one.probability for one in others) < 0.75


class AskedError(Exception):
    pass


class Asked(Lab):
    def proposals(self, *_):
        raise AskedError(f"{torch.get_num_threads()} at work")


def test_it_takes_one_thread_however_many_the_process_has(lab):
    twins, before = lab.twins("level"), torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with pytest.raises(AskedError, match="1 at work"):
            plan(twins.model, twins.measurement, [twins.doubt], lab=Asked(), settings=lab.COARSE)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


@torch.no_grad()
@pytest.mark.parametrize("true", [0, 1])
@pytest.mark.check
def test_after_the_proposed_test_the_right_name_is_sure(planned, lab, true):
    _, twins, found = planned
    proposal = found.proposed.proposal
    test = Forthcoming(twins.bench(proposal), twins.target, twins.doubt, proposal)
    rivals = twins.doubt.rivals
    names, prior = [one.name for one in rivals], [one.probability for one in rivals]
    bench = test.benches[true]
    generator = torch.Generator().manual_seed(11 + true)
    # The plate is as probable as any that the first test leaves, and the second test has a noise of its own.
    off = bench.axes @ torch.randn(len(bench.here), generator=generator, dtype=torch.float64)
    frf = test.says(true, (bench.here + off).clamp(0.0, 1.0))
    read = lab.measured(frf, 29 + true).frf
    evidence = [refitted(test, k, read).evidence for k in range(len(rivals))]
    assert posterior(names, prior, evidence)[names[true]] > 0.95


def test_a_name_that_is_sure_needs_no_test_and_the_best_narrows_its_numbers(lab):
    twins = lab.twins("level")
    sure = dataclasses.replace(twins.doubt, rivals=twins.doubt.rivals[:1])
    room = Lab(("sensor", "mass"), n_place=1, shares=(0.03,))
    found = plan(twins.model, twins.measurement, [sure], lab=room, imperfections=lab.TOLD, settings=lab.COARSE)
    assert not found.needed
    ratios = [one.narrowing for one in found.scored]
    assert ratios == sorted(ratios)
    # The same noise once more takes √2 off where nothing else is left; nothing makes an interval wider.
    assert 0.3 < ratios[0] < 0.9
    assert set(found.proposed.gain.narrowed) == set(twins.doubt.rivals[0].searched)
