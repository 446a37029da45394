"""A line every ten seconds where the output is piped and no bar can be shown."""

import threading
import time
from types import TracebackType

from rich.console import Console

EVERY = 10.0
"""Seconds between lines."""


class Heartbeat:
    """Says where a search stands, also while a single generation takes minutes.

    Args:
        console: where to; on a terminal, which has a bar, nothing is said.
        total: generations at most.
        every: seconds between lines; `EVERY` if left out.
    """

    def __init__(self, console: Console, total: int, every: float | None = None) -> None:
        self.console, self.total = console, total
        self.every = EVERY if every is None else every
        self._standing = "preparing the first generation"
        self._began = time.monotonic()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def beat(self, generation: int, best: float, rate: float) -> None:
        """Where the search stands.

        Args:
            generation: generations done.
            best: the best objective so far.
            rate: evaluations per second.
        """
        left = ""
        if 0 < generation < self.total:
            seconds = (time.monotonic() - self._began) * (self.total - generation) / generation
            left = f", {_duration(seconds)} left at most"
        self._standing = f"generation {generation}/{self.total}, best {best:.6g}, {rate:.0f} evaluations/s{left}"

    def __enter__(self) -> "Heartbeat":
        if not self.console.is_terminal:
            self._thread = threading.Thread(target=self._say, daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _say(self) -> None:
        while not self._ended.wait(self.every):
            passed = _duration(time.monotonic() - self._began)
            self.console.print(f"  {passed}: {self._standing}", highlight=False, soft_wrap=True)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
