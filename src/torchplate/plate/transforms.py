"""What may be remembered: results that no transform of torch and no derivative has a part in."""

import torch
from torch import Tensor
from torch.autograd import forward_ad

# Things of a kind that are remembered, and rows in each at most.
REMEMBERED, MOST_ROWS = 32, 64


def transformed() -> bool:
    """Whether a transform of `torch.func` or forward mode is at work: what is made inside one belongs to it."""
    return torch._C._functorch.peek_interpreter_stack() is not None or forward_ad._current_level >= 0


def is_vmapped(*values: object) -> bool:
    """Whether `torch.func.vmap` has a part in one of some values, so that nobody may look at what it holds.

    Derivatives wrap a value without hiding it, at any depth.
    """
    for value in values:
        while isinstance(value, Tensor):
            if torch._C._functorch.is_batchedtensor(value):
                return True
            if not torch._C._functorch.is_gradtrackingtensor(value):
                break
            value = torch._C._functorch.get_unwrapped(value)
    return False


def stays(value: Tensor) -> bool:
    """Whether a few rows on the CPU are constants, so that what is made of them may be remembered."""
    if value.ndim != 2 or len(value) > MOST_ROWS or value.requires_grad or value.device.type != "cpu":
        return False
    return not transformed() and not torch.is_inference_mode_enabled()
