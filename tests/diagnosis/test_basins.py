"""Where fits begin when nothing is known, and where an effect may go from nothing."""

import pytest
import torch

from torchplate.diagnosis import basins
from torchplate.diagnosis.basins import _spread, fit_from_the_box
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.fit import NOBODY, Beat, fit
from torchplate.diagnosis.judged import judged_at
from torchplate.effects import CATALOGUE


def test_members_are_spread_over_what_is_told_and_over_the_box_elsewhere(lab):
    model = lab.Scene().state.model
    first = torch.tensor([0.5, 0.4], dtype=torch.float64)
    members = _spread(model, {"plate.youngs_modulus": (2.1e11, 2e9)}, first, [0, 1], 64)
    young = model.space.to_si(members)[:, model.names.index("plate.youngs_modulus")]
    # Sixty-four quantiles of a normal distribution, cut at one in a hundred.
    assert float(young.mean()) == pytest.approx(2.1e11, abs=2e8)
    assert float(young.std()) == pytest.approx(2e9, rel=0.1)
    other = members[:, model.names.index("loss.stiffness_loss_factor")]
    assert float(other.min()) < 0.05
    assert float(other.max()) > 0.95


def test_what_is_not_free_stays_where_the_first_start_has_it(lab):
    model = lab.Scene().state.model
    first = torch.tensor([0.3, 0.4], dtype=torch.float64)
    members = _spread(model, {}, first, [1], 16)
    assert torch.allclose(members[:, 0], first[0].expand(16))
    assert len(members[:, 1].unique()) > 8


@torch.no_grad()
@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_likelihood_decides_between_basins(lab, monkeypatch, order):
    """The first is that of the lowest smoothed residuals; where it leaves noise alone the others are not asked."""
    scene = lab.Scene(hidden={"gain": 1.0})
    model = scene.state.model
    truth = model.space.to_cube(torch.tensor([[2.05e11, 1e-2]], dtype=torch.float64))
    known = fit(scene.builder, model, truth, wide=False)
    ends = [torch.tensor([0.7, 0.6], dtype=torch.float64), model.space.to_cube(known.theta)]
    asked = []

    def as_it_is(builder, model, start, prior, wide, hopeless, beat):
        asked.append(hopeless)
        assert beat == NOBODY
        return judged_at(builder, known, prior, start[0])

    monkeypatch.setattr(basins, "fit", as_it_is)
    monkeypatch.setattr(basins, "_basins", lambda *_: [ends[index] for index in order])
    found = fit_from_the_box(scene.builder, model, {})
    assert torch.allclose(found.theta, known.theta)
    assert len(asked) == (2 if order[0] == 0 else 1)


@torch.no_grad()
def test_what_leads_nowhere_near_where_it_ended_already_is_not_followed(lab, monkeypatch):
    scene = lab.Scene(hidden={"gain": 1.0})
    model, before, asked = scene.state.model, scene.fit._replace(way=5.0), []
    far = torch.tensor([[0.7, 0.6], [0.2, 0.9]], dtype=torch.float64)

    def as_it_is(builder, model, start, prior, wide, hopeless, beat):
        asked.append((hopeless, beat))
        return judged_at(builder, scene.fit, prior, start[0])

    monkeypatch.setattr(basins, "fit", as_it_is)
    monkeypatch.setattr(basins, "_basins", lambda *_: list(far))
    found = fit_from_the_box(scene.builder, model, {}, before=before)
    # What is found stays what the box leads to, and is told from where it ended before.
    assert found.cost > before.cost
    limit = scene.builder.target.settings.searching.hopeless * before.square
    assert asked == [(limit, Beat(5.0, before.cost))] * 2


def test_an_effect_that_begins_at_nothing_has_one_direction(lab):
    scene = lab.Scene()
    model, theta = scene.state.model, scene.fit.theta
    seen = set()
    for one in candidates(model, theta, scene.ranking.channels):
        strengths = one.searched.keys() - {"x", "y", "size"}
        if "x" not in one.searched or len(strengths) != 1:
            continue
        (key,) = strengths
        begins = CATALOGUE[one.name].parameters[key].neutral
        both_ways = one.searched[key].low < begins < one.searched[key].high
        for trial in (*one.near, *one.far):
            assert (trial.lowest < 0) == both_ways, one.name
        seen.add(both_ways)
    # Masses, springs, dashpots and damping begin at nothing; a stiffness of a patch goes up and down.
    assert seen == {True, False}
