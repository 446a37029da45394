"""Peaks stand out by what scipy.signal says they do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import find_peaks

from torchplate.measurement.prominence import prominent

# Few levels, so that there are level tops, level valleys and peaks of one height; and numbers that are none.
LEVELS = st.sampled_from([0.0, 1.0, 2.0, 2.5, 7.0, float("nan")])


@given(arrays(np.float64, st.integers(0, 40), elements=LEVELS), st.sampled_from([0.5, 1.0, 2.0, 6.0]))
def test_they_are_those_of_scipy(values, least):
    expected, _ = find_peaks(values, prominence=least)
    assert prominent(values, least).tolist() == expected.tolist()


@pytest.mark.parametrize("least", [0.1, 3.0, 12.0])
def test_they_are_those_of_scipy_in_a_long_noisy_row(least):
    draw = np.random.default_rng(5)
    values = np.cumsum(draw.standard_normal(3200)) + 20 * draw.random(3200)
    expected, _ = find_peaks(values, prominence=least)
    assert len(expected) > 10
    assert prominent(values, least).tolist() == expected.tolist()


def test_a_level_top_is_one_peak_in_its_middle_and_valleys_reach_to_what_is_higher():
    #                  0  1  2  3  4  5  6  7  8
    values = np.array([3, 1, 5, 5, 5, 4, 9, 2, 2], dtype=float)
    assert prominent(values, 1.0).tolist() == [3, 6]
    # The first peak's right valley reaches to the 9: it is 4, so the peak stands out by 1 only.
    assert prominent(values, 1.5).tolist() == [6]
