"""Test problems that carry their optimum: off the middle, unlike in every direction, on the unit cube."""

import math
from collections.abc import Callable
from typing import NamedTuple

import pytest
import torch
from torch import Tensor


class Problem(NamedTuple):
    """An objective of the unit cube with its only global minimum, of value 0, at `optimum`.

    A search has reached the basin when no coordinate of its best position is `radius` away from the optimum:
    about half the way to the next local minimum, or for a valley a small part of its length. An
    objective of `target` or less is found nowhere else. Every optimiser gets there with `n_evaluation` evaluations
    and `n_member` members.
    """

    name: str
    objective: Callable[[Tensor], Tensor]
    optimum: Tensor
    radius: float
    target: float
    n_evaluation: int
    n_member: int = 32

    @property
    def n_dimension(self) -> int:
        return len(self.optimum)

    def reached(self, position: Tensor) -> Tensor:
        return ((position - self.optimum).abs() < self.radius).all(dim=-1)


def tensor(*value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def turned(n_dimension: int) -> Tensor:
    """A rotation by 0.5 rad in the plane of each pair of neighbouring axes."""
    rotation = torch.eye(n_dimension, dtype=torch.float64)
    for k in range(n_dimension - 1):
        step = torch.eye(n_dimension, dtype=torch.float64)
        cosine, sine = math.cos(0.5), math.sin(0.5)
        step[k : k + 2, k : k + 2] = tensor(cosine, -sine, sine, cosine).reshape(2, 2)
        rotation = rotation @ step
    return rotation


def sphere() -> Problem:
    optimum, stretch = tensor(0.23, 0.71, 0.38, 0.64), tensor(1.0, 2.0, 3.0, 4.0)
    rotation = turned(4)
    return Problem(
        "sphere",
        lambda x: ((((x - optimum) @ rotation) * stretch) ** 2).sum(dim=-1),
        optimum,
        radius=0.01,
        target=1e-4,
        n_evaluation=4000,
    )


def rosenbrock() -> Problem:
    width, optimum = tensor(4.0, 3.0, 3.5), tensor(0.7, 0.55, 0.62)

    def objective(x: Tensor) -> Tensor:
        z = 1.0 + (x - optimum) * width
        head, tail = z[..., :-1], z[..., 1:]
        return (100.0 * (tail - head**2) ** 2 + (1.0 - head) ** 2).sum(dim=-1)

    return Problem("rosenbrock", objective, optimum, radius=0.1, target=1e-3, n_evaluation=12000)


def rastrigin() -> Problem:
    width, optimum = tensor(8.0, 10.0, 9.0), tensor(0.31, 0.57, 0.68)

    def objective(x: Tensor) -> Tensor:
        z = (x - optimum) * width
        return (z**2 - 10.0 * torch.cos(2.0 * math.pi * z) + 10.0).sum(dim=-1)

    # The next minima are about 1 / width away.
    return Problem("rastrigin", objective, optimum, radius=0.04, target=0.1, n_evaluation=8000)


def ackley() -> Problem:
    optimum, rotation = tensor(0.28, 0.66, 0.41, 0.73), turned(4)

    def objective(x: Tensor) -> Tensor:
        z = ((x - optimum) * 40.0) @ rotation
        hollow = -20.0 * torch.exp(-0.2 * (z**2).mean(dim=-1).sqrt())
        return hollow - torch.exp(torch.cos(2.0 * math.pi * z).mean(dim=-1)) + 20.0 + math.e

    # The next minima are about 1 / 40 away.
    return Problem("ackley", objective, optimum, radius=0.01, target=0.5, n_evaluation=8000)


def griewank() -> Problem:
    width, optimum = tensor(30.0, 40.0), tensor(0.36, 0.67)
    order = tensor(1.0, 2.0).sqrt()

    def objective(x: Tensor) -> Tensor:
        z = (x - optimum) * width
        return (z**2).sum(dim=-1) / 4000.0 - torch.cos(z / order).prod(dim=-1) + 1.0

    # The next minima are π / 30 and π √2 / 40 away, along both axes at once.
    # Small populations settle in a neighbour, worse by 0.0074 only
    # (SciPy's rand1bin with 32 members: one in four).
    return Problem("griewank", objective, optimum, radius=0.05, target=5e-3, n_evaluation=16000, n_member=100)


PROBLEMS = {make.__name__: make for make in (sphere, rosenbrock, rastrigin, ackley, griewank)}


# Those of many evaluations are for `make check`; each way of going wrong has one that is not.
LONG = ("griewank", "rosenbrock")


@pytest.fixture(
    params=[pytest.param(name, marks=pytest.mark.check) if name in LONG else name for name in sorted(PROBLEMS)]
)
def problem(request: pytest.FixtureRequest) -> Problem:
    """Each test problem in turn."""
    return PROBLEMS[request.param]()


@pytest.fixture
def ellipsoid() -> Problem:
    """The rotated sphere alone."""
    return sphere()
