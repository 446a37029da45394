"""What a fit keeps of what it was judged by."""

import gc
import weakref
from dataclasses import replace

import pytest

from torchplate.diagnosis import judged
from torchplate.diagnosis.judged import LAST
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Imperfections


@pytest.mark.check
def test_nuisances_of_fits_long_past_are_given_back_and_made_again_the_same(lab):
    """Those of every hypothesis, each as long as all FRFs times their number, would be gigabytes."""
    scene = lab.Scene(hidden={"gain": 1.0})
    first = scene.hypothesis("sensor_gain").fit
    seen = first.marginal.judge(first.marginal.residual(scene.builder.target.off(first.expected, first.about)))
    alive = weakref.ref(first.marginal)
    others = [scene.hypothesis("sensor_gain", start=0.5 + 0.1 * turn).fit for turn in range(LAST.maxlen)]
    gc.collect()
    assert alive() is None
    assert all(one.marginal is not None for one in others)
    again = first.marginal
    assert again is first.marginal
    assert again.judge(again.residual(scene.builder.target.off(first.expected, first.about))).cost == seen.cost


def test_of_many_frfs_only_the_newest_nuisances_are_kept(lab, monkeypatch):
    """Three of some seventy columns of 121 FRFs are 283 MiB."""
    scene = lab.Scene(hidden={"gain": 1.0})
    fit, target = scene.state.fit, replace(scene.builder.target, imperfections=Imperfections())
    large = target.marginal(fit.reduced, fit.theta).nbytes
    # At least as many columns as the six FRFs share, each as long as all of them, real and imaginary parts.
    assert large > 8 * 2 * target.measured.numel() * 6
    made, beside = FrfTarget.marginal, []
    monkeypatch.setattr(FrfTarget, "marginal", lambda *told: beside.append(len(LAST)) or made(*told))
    for most, n_kept in ((2.5 * large, 2), (0.5 * large, 1)):
        monkeypatch.setattr(judged, "MOST_KEPT", most)
        every = [judged.beside(target, fit.reduced, fit.theta) for _ in range(3)]
        assert len(LAST) == n_kept
        # There was room for the last one before it was made.
        assert beside[-1] == n_kept - 1
        # What is asked for is there again.
        assert every[0]() is LAST[-1]
