"""What a table of natural frequencies without standard deviations is said to scatter by."""

import pytest

from torchplate.measurement import NaturalFrequencies, assumed


@pytest.mark.parametrize(
    ("values", "rounded"), [((41.0, 77.5), "0.029 Hz, the rounding"), ((41.012345678901234, 77.51234567890123), "")]
)
def test_a_rounding_is_named_where_it_counts(values, rounded):
    told = assumed(NaturalFrequencies.from_mapping(dict(enumerate(values, 4))))
    assert "a standard deviation of 0.1 % is assumed, the scatter of a careful test" in told
    assert (rounded in told) if rounded else ("rounding" not in told)
