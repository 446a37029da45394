"""Whether a file holds a checkpoint that a search can go on from."""

from typing import Any

import torch

from torchplate.search import Checkpoint, Optimizer, Progress, Status, minimize


def fault(held: object, optimizer: Optimizer[Any], n_repeat: int, n_dimension: int) -> str | None:
    """What is wrong with a checkpoint; None where a search of this kind has written it.

    Args:
        held: what the file holds.
        optimizer: as it is set now.
        n_repeat: independent searches.
        n_dimension: searched parameters.
    """
    if not isinstance(held, dict) or not all(isinstance(one, torch.Tensor) for one in held.values()):
        return "something else than named tensors"
    fresh = _fresh(optimizer, n_repeat, n_dimension)
    if set(held) != set(fresh):
        return f"other parts ({', '.join(sorted(map(str, set(held) ^ set(fresh)))[:3])})"
    name = held["optimizer"]
    if name.ndim != 1 or name.dtype != torch.uint8 or bytes(name.tolist()) != optimizer.name.encode():
        return "those of another optimizer"
    population = held["state.population"]
    shrunk = population.ndim == 3 and 0 < population.shape[1] < optimizer.n_member
    for key, new in fresh.items():
        one = held[key]
        # Whether the generator's state fits is for the device to say.
        if key not in ("optimizer", "generator") and (_kind(one) != _kind(new) or not _fits(one, new, shrunk)):
            return f"{key} of another shape or kind"
    if held["state.fitness"].shape != population.shape[:2]:
        return "a fitness for other members"
    if not bool(((population >= 0) & (population <= 1)).all()):
        return "members outside the unit cube"
    counts = [held[name] for name in ("generation", "ledger.n_evaluation", "ledger.n_generation", "ledger.n_idle")]
    status = held["ledger.status"]
    if any(bool((count < 0).any()) for count in counts) or not bool(((status >= -1) & (status < len(Status))).all()):
        return "counts that cannot be"
    return None


def _fits(one: torch.Tensor, new: torch.Tensor, shrunk: bool) -> bool:
    """Whether a part has the shape of a search that has just begun, or, where its members are fewer now, a smaller."""
    smaller = len(one.shape) == len(new.shape) and all(
        0 < size <= whole for size, whole in zip(one.shape[1:], new.shape[1:], strict=True)
    )
    return one.shape == new.shape or (shrunk and smaller and one.shape[:1] == new.shape[:1])


def _fresh(optimizer: Optimizer[Any], n_repeat: int, n_dimension: int) -> Checkpoint:
    """The checkpoint of a search that has just begun."""
    found: list[Checkpoint] = []

    def keep(progress: Progress) -> None:
        found.append(progress.checkpoint())

    minimize(
        lambda position: position.sum(-1),
        optimizer,
        n_dimension=n_dimension,
        generator=torch.Generator().manual_seed(0),
        batch_shape=(n_repeat,),
        n_generation=0,
        on_generation=keep,
    )
    return found[0]


def _kind(tensor: torch.Tensor) -> str:
    if tensor.is_floating_point():
        return "number"
    return "count" if tensor.dtype == torch.int64 else str(tensor.dtype)
