"""Descents that an interrupted computation had made, recalled in their order.

A computation that draws nothing at random makes the same descents in the same order: repeated, it need not make those
again whose ends are known. Whether it is the same is seen by where each of them starts, to the last bit.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Descent(NamedTuple):
    """One call of a least-squares search.

    Attributes:
        start: on the unit cube.
        position: where each start ended.
        objective: half the sum of squares there.
        n_evaluation: what it cost.
    """

    start: Float[Tensor, "n_start n"]
    position: Float[Tensor, "n_start n"]
    objective: Float[Tensor, " n_start"]
    n_evaluation: int


class Recall:
    """What was made before, and what is made now.

    Args:
        past: descents of the same computation, in their order.
        made: is shown all descents after each new one.
    """

    def __init__(self, past: Sequence[Descent], made: Callable[[Sequence[Descent]], object]) -> None:
        self.past, self.made = list(past), made
        self._done: list[Descent] = []

    def next(self, start: Float[Tensor, "n_start n"], descend: Callable[[], Descent]) -> tuple[Descent, bool]:
        """The next descent, and whether it was recalled; where the computation is another one, the past is dropped."""
        place = len(self._done)
        if place < len(self.past) and torch.equal(self.past[place].start, start.cpu()):
            found, known = self.past[place], True
            found = found._replace(position=found.position.to(start), objective=found.objective.to(start))
        else:
            self.past = []
            found, known = descend(), False
        self._done.append(Descent(start.cpu(), found.position.cpu(), found.objective.cpu(), found.n_evaluation))
        if not known:
            self.made(self._done)
        return found, known


_RECALL: ContextVar[Recall | None] = ContextVar("recall", default=None)


@contextmanager
def recalling(recall: Recall) -> Iterator[None]:
    """For as long as this lasts, descents go through it."""
    token = _RECALL.set(recall)
    try:
        yield
    finally:
        _RECALL.reset(token)


def recalled(start: Float[Tensor, "n_start n"], descend: Callable[[], Descent]) -> tuple[Descent, bool]:
    """A descent, and whether it was made before; nothing is recalled where nobody asked for it.

    Args:
        start: on the unit cube.
        descend: makes it.
    """
    recall = _RECALL.get()
    return (descend(), False) if recall is None else recall.next(start, descend)
