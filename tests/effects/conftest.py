"""One example for each effect of the catalogue: fixed options, and values away from neutral that a test can see."""

from typing import Any, NamedTuple

import pytest

from torchplate.effects import CATALOGUE, Effect


class Example(NamedTuple):
    """Options of the effect, and its parameters."""

    options: dict[str, Any]
    value: dict[str, float]


EXAMPLES = {
    "plate": Example({}, {"youngs_modulus": 71e9, "poisson_ratio": 0.33, "density": 2700.0, "thickness": 0.004}),
    "point_mass": Example({}, {"x": 0.61, "y": 0.28, "mass": 0.06}),
    "support_spring": Example({"nodes": (2, 9, 30)}, {"stiffness": 4.1e4, "viscous_damping": 3.0}),
    "exponential_window": Example({}, {"rate": 1.5}),
    "hysteretic_damping": Example({}, {"stiffness_loss_factor": 0.01, "mass_loss_factor": 40.0}),
    "viscous_damping": Example({}, {"mass_coefficient": 2.0, "stiffness_coefficient": 3e-5}),
}


@pytest.fixture(params=list(CATALOGUE))
def effect(request: pytest.FixtureRequest) -> type[Effect]:
    return CATALOGUE[request.param]


@pytest.fixture
def example(effect: type[Effect]) -> Example:
    if effect.name not in EXAMPLES:
        pytest.fail(f"The effect '{effect.name}' has no example. Add one to EXAMPLES in tests/effects/conftest.py.")
    return EXAMPLES[effect.name]
