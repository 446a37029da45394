"""Numbers in print have the digits that say something."""

import pytest

from torchplate.report.blocks.numbers import figure_digits, interval, listed


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (0.213, 0.011, "0.213 ± 0.011"),
        (6.6123456e10, 1.4e7, "6.6123e+10 ± 1.4e+07"),
        (0.003, 0.2, "0.003 ± 0.2"),
        (0.0, 0.2, "0 ± 0.2"),
        (1234.5678, None, "1235"),
        (0.024037, 8.5e-5, "0.024037 ± 0.000085"),
        (2.5, 0.0, "2.5"),
    ],
)
def test_numbers_have_the_digits_that_their_error_leaves(value, std, text):
    assert figure_digits(value, std) == text


def test_the_ends_of_an_interval_have_the_digits_that_its_error_leaves():
    assert interval(1.95983e11, 1.96017e11, 9.9e6) == "1.95983e+11 to 1.96017e+11"
    assert interval(0.26868, 0.27040) == "0.2687 to 0.2704"
    assert interval(None, 1.0) == interval(1.0, None, 0.1) == ""


def test_words_are_joined_as_a_sentence_has_them():
    assert [listed(words) for words in ((), ("a",), ("a", "b"), ("a", "b", "c"))] == ["", "a", "a and b", "a, b and c"]
