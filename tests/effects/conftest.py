"""One example for each effect of the catalogue: fixed options, and values away from neutral that a test can see.

And the plate on which the catalogue's tests try them.
"""

from typing import Any, NamedTuple

import pytest

from torchplate.effects import CATALOGUE, Effect


class Example(NamedTuple):
    """Options of the effect, and its parameters."""

    options: dict[str, Any]
    value: dict[str, float]


# The plate that the examples are tried on, where its supports are, and where it is read and hit.
BARE = {
    "plate.youngs_modulus": 69e9,
    "plate.poisson_ratio": 0.31,
    "plate.density": 2710.0,
    "plate.thickness": 0.0031,
    "wires.stiffness": 4e3,
    "loss.stiffness_loss_factor": 0.004,
    # Some effects change what only a plate with a grain has.
    "grain.young_ratio": 0.6,
    "grain.shear_factor": 1.2,
}
WIRES = ((0.21, 0.0), (0.66, 0.94))
RESPONSE, REFERENCE = [3, (0.6, 0.7)], [8, (0.71, 0.64)]

EXAMPLES = {
    "absorber": Example({}, {"x": 0.61, "y": 0.28, "mass": 0.05, "stiffness": 2.3e4, "viscous_damping": 1.7}),
    "plate": Example({}, {"youngs_modulus": 71e9, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.0033}),
    "point_mass": Example({}, {"x": 0.61, "y": 0.28, "mass": 0.06}),
    "support_spring": Example({"nodes": (2, 9, 30)}, {"stiffness": 4.1e4, "viscous_damping": 3.0}),
    "exponential_window": Example({}, {"rate": 1.5}),
    "hysteretic_damping": Example({}, {"stiffness_loss_factor": 0.01, "mass_loss_factor": 40.0}),
    "viscous_damping": Example({}, {"mass_coefficient": 2.0, "stiffness_coefficient": 3e-5}),
    "air_loading": Example({}, {"density": 1.2}),
    "aspect_ratio": Example({}, {"ratio": 1.06}),
    "orthotropy": Example({}, {"young_ratio": 1.4, "shear_factor": 0.8}),
    "poisson_ratio": Example({}, {"value": 0.27}),
    "density": Example({}, {"value": 2480.0}),
    "thickness": Example({}, {"value": 0.0029}),
    "thickness_taper": Example({}, {"slope_x": 0.17, "slope_y": -0.24}),
    "stiffness_loss": Example({}, {"x": 0.63, "y": 0.31, "size": 0.37, "factor": 0.4, "aspect": 1.4}),
    "grain_angle": Example({}, {"angle": 0.31}),
    "rib": Example(
        {},
        {"x0": 0.12, "y0": 0.23, "x1": 0.87, "y1": 0.71, "bending": 60.0, "torsion": 25.0, "mass_per_length": 0.3},
    ),
    "cut_out": Example({}, {"x0": 0.22, "y0": 0.33, "x1": 0.57, "y1": 0.81}),
    "thickness_field": Example({}, {"a10": 0.02, "a01": -0.013, "a11": 0.017, "a20": 0.011, "a02": -0.019}),
    "field": Example(
        {"kind": "stiffness", "n_x": 2, "n_y": 3},
        {"value_1": -0.3, "value_2": 0.2, "value_3": -0.45, "value_4": 0.35, "value_5": 0.15, "value_6": -0.25},
    ),
    "damping_patch": Example({}, {"x": 0.63, "y": 0.31, "size": 0.37, "loss_factor": 0.2, "aspect": 0.7}),
    "directional_damping": Example({}, {"loss_x": 0.008, "loss_y": 0.03, "loss_xy": 0.02}),
    "frequency_dependent_loss": Example({}, {"exponent": 0.45}),
    "ground_spring": Example({}, {"x": 0.61, "y": 0.28, "stiffness": 2.3e4}),
    "ground_dashpot": Example({}, {"x": 0.61, "y": 0.28, "viscous_damping": 7.0}),
    "support_asymmetry": Example({"at": WIRES}, {"factor_1": 1.6, "factor_2": 0.7}),
    "edge_spring": Example({"edge": "x1"}, {"stiffness": 3e4, "rotational_stiffness": 50.0}),
    "time_delay": Example({}, {"delay": 3e-4}),
    "sensor_gain": Example({}, {"gain": 1.3}),
    "roving_mass": Example({}, {"mass": 0.045}),
    "sensor_position": Example({}, {"dx": 0.011, "dy": -0.008}),
    "channel_polarity": Example({"channels": ((None, 8),)}, {}),
    "channel_swap": Example({"channels": ((3, None), ((0.6, 0.7), None))}, {}),
    "mesh_discretisation": Example({"refine": 2}, {}),
}


@pytest.fixture(params=list(CATALOGUE))
def effect(request: pytest.FixtureRequest) -> type[Effect]:
    return CATALOGUE[request.param]


@pytest.fixture
def example(effect: type[Effect]) -> Example:
    if effect.name not in EXAMPLES:
        pytest.fail(f"The effect '{effect.name}' has no example. Add one to EXAMPLES in tests/effects/conftest.py.")
    return EXAMPLES[effect.name]
