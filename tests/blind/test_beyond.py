"""What is beyond the catalogue is the plain plate where there is none of it, and another where there is some."""

from dataclasses import replace

import numpy as np
import pytest

from blind.beyond import KINDS, clipped_channel, cubic_spring, draw, frequency_dependent_modulus
from blind.effects import Truth
from blind.response import Chain, Damping, Test, frf
from blind.test_ritz import PLATE

TEST = Test([(0.25, 0.375), (0.75, 0.25)], [(0.75, 0.875)], np.arange(5.0, 400.5, 1.0), "accelerance")
PARTS = PLATE, Damping(0.004), Chain(), TEST


@pytest.mark.parametrize(
    "neutral",
    [
        lambda: cubic_spring(*PARTS, (0.3, 0.6), 1e-3, 1.0),
        lambda: frequency_dependent_modulus(*PARTS, 0.0, 100.0),
        lambda: clipped_channel(*PARTS, 1, 1.0),
    ],
    ids=["cubic spring", "modulus", "clipped"],
)
def test_nothing_of_it_is_the_plain_plate(neutral):
    plain = frf(*PARTS)
    np.testing.assert_allclose(neutral(), plain, rtol=1e-6, atol=1e-9 * np.abs(plain).max())


def test_a_spring_that_stiffens_answers_less_to_a_larger_force():
    small, large = (cubic_spring(*PARTS, (0.3, 0.6), 1e9, force) for force in (1e-3, 10.0))
    plain = frf(*PARTS)
    assert np.linalg.norm(small - plain) < 1e-2 * np.linalg.norm(plain)
    assert np.linalg.norm(large - plain) > 0.1 * np.linalg.norm(plain)


def test_the_cubic_solution_solves_its_own_equation():
    """The dynamic stiffness at the place, with the secant spring there, gives back the motion that sets the spring."""
    place, cubic, force = (0.3, 0.6), 3e9, 1.0
    line = Test([place], TEST.reference, np.array([61.0]), "receptance")
    amplitude = force * np.abs(cubic_spring(PLATE, *PARTS[1:3], line, place, cubic, force)[0, 0, 0])
    spring = 0.75 * cubic * amplitude**2
    # The equivalent spring is real, while the plate's own springs have the loss factor: undo it at that place.
    linear = frf(replace(PLATE, springs=[*PLATE.springs, (*place, spring)]), *PARTS[1:3], line)[0, 0, 0]
    assert abs(linear) * force == pytest.approx(amplitude, rel=0.02)


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_can_be_drawn(name):
    found, sizes = draw(np.random.default_rng(1), name, Truth(*PARTS))
    assert found.shape == (396, 2, 1)
    assert np.isfinite(found).all()
    assert sizes
    assert np.linalg.norm(found - frf(*PARTS)) > 1e-3 * np.linalg.norm(found)
