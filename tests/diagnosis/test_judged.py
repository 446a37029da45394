"""What a fit keeps of what it was judged by."""

import gc
import weakref

from torchplate.diagnosis.judged import LAST


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
