"""Bending waves are as long as those that stand on a simply supported plate; materials are what they are called."""

import math

import pytest

from torchplate.plate import (
    MATERIALS,
    bending_wavelength,
    elements_for,
    find_material,
    frequency_of_wavelength,
    thickness_of,
)

STEEL = (205e9, 0.29, 7850.0, 0.0031)


def test_a_wave_is_as_long_as_the_mode_that_it_makes_on_a_simply_supported_plate():
    side = 0.37
    young, poisson, density, thickness = STEEL
    rigidity = young * thickness**3 / (12 * (1 - poisson**2))
    # Navier: the mode (3, 2), whose wave number is π √(9 + 4) / side.
    number = math.pi * math.sqrt(13) / side
    frequency = number**2 * math.sqrt(rigidity / (density * thickness)) / (2 * math.pi)
    assert bending_wavelength(frequency, *STEEL) == pytest.approx(2 * math.pi / number, rel=1e-12)
    assert frequency_of_wavelength(2 * math.pi / number, *STEEL) == pytest.approx(frequency, rel=1e-12)


def test_the_number_of_modes_tells_the_thickness():
    young, poisson, density, thickness = STEEL
    sides, top = (0.61, 0.44), 40e3
    speed = math.sqrt(young * thickness**2 / (12 * (1 - poisson**2) * density))
    limit = math.sqrt(2 * math.pi * top / speed) / math.pi
    count = sum(math.hypot(m / sides[0], n / sides[1]) <= limit for m in range(1, 300) for n in range(1, 300))
    # Waves along the edges are missing from the count: perimeter over √area · √count, 6 % of these 480 modes.
    found = thickness_of(sides[0] * sides[1], count / top, young, poisson, density)
    assert found == pytest.approx(thickness, rel=0.12)
    assert found > thickness


def test_eight_elements_stand_on_a_wave():
    assert elements_for(0.48, 0.24) == 16
    assert elements_for(0.48, 10.0) == 4
    assert elements_for(0.48, 0.239) == 18


@pytest.mark.parametrize("name", MATERIALS)
def test_the_usual_value_of_a_material_lies_between_its_ends(name):
    material = MATERIALS[name]
    for low, usual, high in (material.youngs_modulus, material.density):
        assert low < usual < high
    assert 0 < material.poisson_ratio < 0.5
    # A ratio known no better than this would let a plate of it shrink when it is pulled.
    assert 0 < material.poisson_std <= 0.5 * material.poisson_ratio
    assert 0 < material.loss_factor[0] < material.loss_factor[1] < 1
    assert material.young_ratio >= 1
    assert material.source


def test_a_material_answers_to_the_ways_it_is_spelt():
    assert find_material("Aluminum") is MATERIALS["aluminium"]
    assert find_material("stainless steel") is MATERIALS["stainless_steel"]
    with pytest.raises(KeyError, match="No material named 'unobtainium'"):
        find_material("unobtainium")
    with pytest.raises(KeyError, match="Did you mean 'aluminium'"):
        find_material("Alumnium")
