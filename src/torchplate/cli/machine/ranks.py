"""Processes that `torchrun` has started together: how they meet, what rank 0 tells the others, how they end.

Rank 0 alone reads, prepares, writes and speaks. The others wait for its job, which holds the model and its reduced
basis: they need no file, what is wrong with the input is found and said once, and the basis (whose last bits depend on
the machine that made it) is the same everywhere. They leave after the search; rank 0 goes on to finish and report.
"""

import io
import os
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import torch
import torch.distributed as dist
from torch.distributed.rendezvous import rendezvous

from torchplate.cli.config import InputError
from torchplate.identification import Job
from torchplate.measurement import MeasurementError
from torchplate.search import ShardingError

# What torchrun tells each process it starts.
LAUNCHED = ("RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
# A rank is lost that is this much later than the others in a generation; one that has ended is noticed at once.
TIMEOUT = timedelta(minutes=5)
# The others wait as long as rank 0 prepares; this stands for ever.
PREPARATION = timedelta(days=7)


class Ended(Exception):  # noqa: N818
    """The ranks could not go on together; the message says what happened, where the checkpoint is and how to go on."""


class _Terminated(BaseException):
    """SIGTERM came: not an Exception, so that nothing on the way takes it for a failed evaluation."""


class Shared(NamedTuple):
    """What rank 0 tells the others.

    Attributes:
        job: the search.
        folder: where rank 0 writes its checkpoints.
        command: what the user types to go on from there.
    """

    job: Job
    folder: Path
    command: str


class Ranks:
    """The processes of one run, seen from one of them.

    Attributes:
        rank: the number of this one, from 0.
        size: how many there are.
        device: where this one's tensors live.
        group: what the search gathers over.
        shared: what rank 0 has told, once it has.
    """

    def __init__(self, device: str, timeout: timedelta) -> None:
        self._store, self.rank, self.size = next(rendezvous("env://", timeout=timeout))
        self.device = device
        if on_gpu := device == "cuda" and torch.cuda.is_available():
            self.device = f"cuda:{os.environ.get('LOCAL_RANK', 0)}"
            torch.cuda.set_device(self.device)
            # Else a lost rank ends the others in the middle of a sentence instead of raising an error.
            os.environ.setdefault("TORCH_NCCL_BLOCKING_WAIT", "1")
        dist.init_process_group("gloo", store=self._store, rank=self.rank, world_size=self.size, timeout=PREPARATION)
        self.group = dist.new_group(backend="nccl" if on_gpu else "gloo", timeout=timeout)
        self.shared: Shared | None = None

    def tell(self, shared: "Shared") -> None:
        """Rank 0: here is the job; all go on to `job.search`."""
        self.shared = shared
        packed = io.BytesIO()
        torch.save(shared, packed)
        dist.broadcast_object_list([packed.getvalue()])

    def dismiss(self, status: int) -> None:
        """Rank 0: there is no job; all leave with this exit status."""
        dist.broadcast_object_list([status])
        # torchrun ends the others when one leaves with an error: not before all have heard their status.
        dist.barrier()

    def hear(self) -> Job:
        """The others: wait for the job.

        Raises:
            SystemExit: if there is none.
        """
        told: list[Any] = [None]
        dist.broadcast_object_list(told)
        if isinstance(told[0], int):
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            dist.barrier()
            raise SystemExit(told[0])
        # Written by rank 0 of this very run, so it may hold more than tensors.
        shared: Shared = torch.load(io.BytesIO(told[0]), weights_only=False)
        self.shared = shared
        return replace(shared.job, device=self.device)

    def leave(self, error: BaseException | None) -> None:
        """Part from the others, and wait until gloo's threads have ended.

        A thread of a group lets go of the last message, whose tensors are Python's, a moment after the main thread goes
        on. If the interpreter ends within that moment, C++ aborts the process ("terminate called without an active
        exception"). A group's threads end with the last reference to it, and the frames of an error hold one too.

        Args:
            error: what ends this process, if anything; its frames let go of what they hold.
        """
        while error is not None:
            traceback.clear_frames(error.__traceback__)
            error = error.__cause__ or error.__context__
        del self.group
        dist.destroy_process_group()

    def first_to_say(self) -> bool:
        """Whether no other rank has said yet what happened."""
        try:
            return self._store.add("torchplate/said", 1) == 1
        except RuntimeError:  # the store went with the rank that kept it
            return True

    def way_on(self) -> str:
        """Where the checkpoint is and how to go on from it."""
        if self.shared is None:
            return "The search had not begun: run it again."
        path = self.shared.folder / "checkpoint.pt"
        if not path.exists():
            return f"There is no checkpoint in {self.shared.folder} yet: run it again."
        generation = int(torch.load(path, weights_only=True, map_location="cpu")["generation"])
        return (
            f"This was in generation {generation + 1}; the checkpoint of generation {generation} is {path}. Go on, "
            f"with any number of processes, by: {self.shared.command}"
        )


@contextmanager
def join(device: str = "cpu", timeout: timedelta = TIMEOUT) -> Iterator[Ranks | None]:
    """Meet the other processes that torchrun has started; None where it has started none.

    Args:
        device: cpu, or cuda for each process's own GPU.
        timeout: how long a rank may keep the others waiting in a generation.

    Raises:
        Ended: on one rank, if another one was lost; the others leave with exit status 1.
        InputError: on rank 0, if there are more processes than GPUs on this machine.
    """
    if not all(name in os.environ for name in LAUNCHED):
        yield None
        return
    _check_gpus(device)
    signal.signal(signal.SIGTERM, _terminated)
    ranks = Ranks(device, timeout)
    status = 0
    try:
        yield ranks
    except (ShardingError, _Terminated) as error:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        status = 1
        if not ranks.first_to_say():
            raise SystemExit(1) from None
        what = "SIGTERM came: a rank was lost or the run was to stop." if isinstance(error, _Terminated) else error
        raise Ended(f"{what} {ranks.way_on()}") from error
    except KeyboardInterrupt:
        status = 130
        if ranks.rank:
            raise SystemExit(status) from None
        raise
    except BaseException as error:
        status = 2 if isinstance(error, InputError | MeasurementError | OSError) else 1
        raise
    finally:
        if ranks.rank == 0 and ranks.shared is None:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            # If one of them is gone already, there is no more to say to the others.
            with suppress(RuntimeError):
                ranks.dismiss(status)
        ranks.leave(sys.exception())


def _terminated(number: int, frame: FrameType | None) -> None:  # noqa: ARG001
    raise _Terminated


def _check_gpus(device: str) -> None:
    """NCCL wants a GPU for each process."""
    n_process = int(os.environ.get("LOCAL_WORLD_SIZE", 1))
    if device != "cuda" or not torch.cuda.is_available() or n_process <= torch.cuda.device_count():
        return
    if int(os.environ.get("LOCAL_RANK", 0)):
        sys.exit(2)
    raise InputError(
        f"--device cuda: Expected at most {torch.cuda.device_count()} processes on this machine, one for each GPU, got "
        f"{n_process}. Give torchrun --nproc-per-node {torch.cuda.device_count()}."
    )
