"""How many lines of a large test are looked at."""

import pytest
import torch

from torchplate.diagnosis import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Channel, Measurement, Noise
from torchplate.measurement.assessment.resonances import Resonances


def a_test(n_line: int, n_reference: int) -> Measurement:
    frequency = torch.linspace(5, 400, n_line, dtype=torch.float64)
    frf = torch.ones(n_line, 1, n_reference, dtype=torch.complex128)
    measured = torch.ones(1, n_reference, dtype=torch.bool)
    references = tuple(Channel(node) for node in range(2, 2 + n_reference))
    return Measurement(frequency, frf, measured, (Channel(1),), references, "receptance", "m/N")


def noise_of(test: Measurement, n_resonance: int | None) -> Noise:
    std = 0.01 * test.frf.abs()
    if n_resonance is None:
        return Noise(std, 0.01, (), torch.zeros_like(std))
    pole = torch.linspace(1e3, 1e5, n_resonance + 1, dtype=torch.float64).to(test.frf)
    parts = test.frf.new_zeros(n_resonance + 1, *test.frf.shape[1:])
    # The last of them is a line that stands out alone.
    resonates = torch.arange(n_resonance + 1) < n_resonance
    return Noise(std, 0.01, (), torch.zeros_like(std), Resonances(pole, parts, parts[:1], (5.0, 400.0), resonates))


@pytest.mark.parametrize(
    ("n_line", "n_reference", "n_resonance", "n_mode", "step"),
    [
        (300, 10, 12, 12, 1),
        (677, 15, 16, 16, 3),
        (3200, 6, 16, 16, 4),
        (3200, 121, 16, 16, 20),
        # Ten for each mode are kept, and as many as forty need where no resonance is known.
        (677, 15, 30, 30, 2),
        (3200, 121, 60, 60, 5),
        (3200, 121, None, 16, 8),
        (3200, 121, 0, 16, 8),
        # Records that drift have each mode at two frequencies; and of some modes there is nothing to see.
        (520, 32, 39, 20, 2),
        (520, 32, 13, 40, 4),
    ],
)
def test_as_many_numbers_are_looked_at_as_any_test_counts(n_line, n_reference, n_resonance, n_mode, step):
    test = a_test(n_line, n_reference)
    target = FrfTarget(test, noise_of(test, n_resonance), torch.zeros_like(test.measured))
    found = target.thinned(n_mode)
    assert torch.equal(found.frequency, test.frequency[::step])
    assert found.noise.std.shape[0] == len(found.frequency)


def test_no_test_counts_more_numbers():
    assert SETTINGS.lines.most_numbers == pytest.approx(1 / SETTINGS.comparison.misspecified)
