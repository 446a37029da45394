"""One thread for what takes one model at a time: of a few dozen modes, more are slower and sum in another order."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from threadpoolctl import threadpool_limits


@contextmanager
def one_thread() -> Iterator[None]:
    """Torch and SciPy's BLAS have one thread meanwhile, and then as many as before.

    What is found does not hang on how many the process was given, to the last digit. It decorates a function as well:
    `@one_thread()`.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        torch.set_num_threads(before)
