"""Percentages have one notation, in which no number is longer than what it says."""

import math
import re

import pytest

from torchplate.discrepancy.notation import percent


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (0.3632, "36.3 %"),
        (0.34, "34 %"),
        (1.0449, "104 %"),
        (12.345, "1230 %"),
        (0.000123, "0.0123 %"),
        (-2.79, "−279 %"),
        (-3.58e-283, "0 %"),
        (0.0, "0 %"),
        (1e-12, "under 0.001 %"),
        (1e9, "over 100 000 %"),
        (-1e9, "below −100 000 %"),
        (math.inf, "over 100 000 %"),
        (math.nan, "not known"),
        (None, ""),
    ],
)
def test_a_part_is_printed_as_it_is_read(part, text):
    assert percent(part) == text


def test_a_percentage_has_no_exponent_and_three_digits_that_are_right():
    for power in range(-5, 3):
        for digits in (1.0, 1.004999, 3.14159, 9.994, 9.996):
            part = digits * 10.0**power
            text = percent(part)
            assert re.fullmatch(r"\d+(\.\d+)? %", text)
            # Three digits leave up to half of the third.
            assert float(text.removesuffix(" %")) == pytest.approx(100 * part, rel=5.001e-3)
