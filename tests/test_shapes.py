"""Shapes and types of what tests hand over are checked, at least at the first call of a function in each file."""

import os

import jaxtyping
import pytest
import torch

from torchplate.model.receptance.modes import natural_frequencies, whiten
from torchplate.plate import Mesh


def test_a_wrong_shape_is_seen_at_the_first_call() -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        whiten(torch.eye(3, dtype=torch.float64), torch.eye(2, dtype=torch.float64))


# Twice in `make check`, where each test begins to count anew.
@pytest.mark.parametrize("turn", [0, 1] if "CHECKED_CALLS" in os.environ else [0])
def test_a_wrong_type_is_seen_at_the_first_call(turn: int) -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        natural_frequencies(torch.zeros(2, dtype=torch.int64))


def test_a_wrong_field_of_a_dataclass_is_seen_too() -> None:
    with pytest.raises(jaxtyping.TypeCheckError):
        Mesh(1.0, "wide", 2, 2)
