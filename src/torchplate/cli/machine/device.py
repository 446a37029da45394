"""The device that `--device` names."""

import torch

from torchplate.cli.config import InputError


def device_named(name: str) -> torch.device:
    """The device of that name.

    Raises:
        InputError: if torch cannot use it.
    """
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"--device {name}: Expected a device that torch can use, got none ({reason}). Use cpu."
        ) from None
    return device
