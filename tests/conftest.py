"""Where the tensors of a test live, on every kind of device that this machine has; and whether types are checked."""

from collections.abc import Iterator

import pytest
import torch
from jaxtyping import config

NO_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA device")


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=NO_GPU)])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Each kind of device in turn."""
    return torch.device(request.param)


@pytest.fixture(scope="module")
def types_unchecked() -> Iterator[None]:
    """Shapes and types are checked by the tests of each part; what is proved from end to end does without."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)
