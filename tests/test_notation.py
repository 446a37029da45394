"""Percentages have one notation, in which no number is longer than what it says."""

import math
import re
from pathlib import Path

import pytest

import torchplate
from torchplate.notation import counted, drop, number_of_percent, percent

ROOT = Path(torchplate.__file__).parent


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


def test_one_thing_is_no_plural():
    assert [counted(n, "FRF") for n in (0, 1, 2)] == ["0 FRFs", "1 FRF", "2 FRFs"]
    assert [counted(n, "frequency", "frequencies") for n in (1, 2)] == ["1 frequency", "2 frequencies"]


@pytest.mark.parametrize(
    ("part", "how", "text"),
    [
        (0.0236, {"digits": 2}, "2.4 %"),
        (0.9968, {"digits": 2}, "100 %"),
        (0.00321, {"decimals": 2}, "0.32 %"),
        (-0.0123, {"decimals": 2, "signed": True}, "−1.23 %"),
        (0.0123, {"decimals": 1, "signed": True}, "+1.2 %"),
        (0.0123, {"signed": True}, "+1.23 %"),
        (2e4, {"decimals": 1}, "over 100 000 %"),
    ],
)
def test_a_column_may_have_the_digits_it_needs(part, how, text):
    assert percent(part, **how) == text


def test_no_sentence_writes_a_percentage_by_hand():
    # "{…:.1%}" has no space before its sign, and "{100 * …}" other digits each time.
    by_hand = {path: re.findall(r"\{[^{}]*%\}|\{100 \* ", path.read_text()) for path in ROOT.rglob("*.py")}
    assert [path.name for path, found in by_hand.items() if found] == ["notation.py"]


def test_below_a_head_that_has_the_sign_it_is_the_same_number():
    assert [number_of_percent(part) for part in (0.3632, 0.0, 2e-3)] == ["36.3", "0", "0.2"]
    assert number_of_percent(-0.0296, decimals=2) == "−2.96"


def test_a_percentage_has_no_exponent_and_three_digits_that_are_right():
    for power in range(-5, 3):
        for digits in (1.0, 1.004999, 3.14159, 9.994, 9.996):
            part = digits * 10.0**power
            text = percent(part)
            assert re.fullmatch(r"\d+(\.\d+)? %", text)
            # Three digits leave up to half of the third.
            assert float(text.removesuffix(" %")) == pytest.approx(100 * part, rel=5.001e-3)


@pytest.mark.parametrize(("part", "text"), [(0.363, "36.3 %"), (-7.82, "none"), (-3.58e-283, "0 %"), (0.0, "0 %")])
def test_what_would_grow_has_no_drop(part, text):
    assert drop(part) == text
