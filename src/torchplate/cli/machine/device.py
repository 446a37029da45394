"""The device that `--device` names."""

import torch
from rich.console import Console

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
        if "at start of device string" in reason:
            raise InputError(
                f"--device {name}: Expected a device that torch knows, got none of its. Use cpu, or cuda for a GPU."
            ) from None
        raise InputError(
            f"--device {name}: Expected a device that torch can use, got none ({reason}). Use cpu."
        ) from None
    return device


def on_cpu_alone(name: str, what: str, console: Console) -> None:
    """Say of work that is done on the CPU that it is, where another device was asked for.

    Args:
        name: of the device.
        what: the work.
        console: where it is said.

    Raises:
        InputError: if torch cannot use the device.
    """
    if device_named(name).type != "cpu":
        console.print(
            f"  Note: {what} computes on the CPU: its many problems are too small for --device {name}, which speeds up "
            "the search of a run of one test.",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
