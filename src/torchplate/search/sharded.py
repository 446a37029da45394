"""An objective that many processes evaluate together, a share of the candidates each.

Every rank runs the same search from the same seed: its state is replicated and never sent. Only the fitness travels, in
one all-gather for each call, so that all ranks end with the same tensor to the last bit and make the same next
candidates. A digest of the candidates travels with it and shows replicas that have drifted apart.

How the numbers compare with those of one process. Which matrix kernel a library takes for a candidate depends on how
many others stand beside it, and on its place among them. Shares are therefore cut at multiples of `GRAIN` candidates:
then a candidate sits in the same register block as in the whole population, and plates come out the same bit for bit
(float64 on a CPU with MKL, as many threads in each rank as in the one process). An objective that cuts its batch by its
size may differ in the last bit, and one that looks at the range of its batch by the error that this choice makes. Cut
anywhere, the fitness of a lightly damped plate on soft wires differs by up to 2e-10: the rounding of the matrices times
the condition of the lowest modes.

What limits it at 1,000 ranks. A generation of N candidates on P ranks takes c + ⌈N / (P · GRAIN)⌉ · GRAIN · t + g(P),
with t for each candidate, c for what every rank repeats and g(P) for the gather.

- N is the cap: at most N / GRAIN ranks have anything to do, 8 of a population of 32. A thousand ranks want 4,000
  candidates or more (so do n_repeat independent searches of one batch: they are shared out alike); members beyond what
  the search can use buy nothing, and a longer search does not shard at all, for generations wait for each other.
- c is Amdahl's term: ask and tell are repeated by every rank, preparation (reading, reduced basis) and the report are
  rank 0's alone, while the others wait. In a reduced basis t is so small that c is soon the larger part.
- g(P) is latency: gloo's ring makes P − 1 steps of 8 (N / P + 1) bytes, so it grows with P where a tree's would
  grow with log₂ P; the bytes, 8 (N + P) in all, are nothing.
- Each generation ends at the slowest rank: one slow machine in a thousand slows all of them.
- A kernel needs a batch: a GPU that is given 4 candidates instead of 400 is idle most of the time.
- One lost rank ends the run: at 1,000 ranks that happens a thousand times as often, which is what the checkpoint of
  every generation is for.
"""

import re

import torch
import torch.distributed as dist
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.search.minimization import Objective, evaluated

GRAIN = 4
"""Candidates that are never parted: see above."""


class ShardingError(RuntimeError):
    """The ranks cannot go on together; the message is a sentence for the user."""


class RankLost(ShardingError):  # noqa: N818  # it is what has happened
    """A rank has ended, or has not answered in time."""


class RanksDiffer(ShardingError):  # noqa: N818
    """The ranks were given different candidates."""


class ShardedObjective:
    """The same objective, evaluated by all ranks of a group together.

    Every rank must call it with the same positions, as often as the others.

    Args:
        objective: what is minimised; each rank calls it with its share, [n_candidate, n_dimension], and not at all
            where there is none for it.
        group: the ranks; all of them if left out.
    """

    def __init__(self, objective: Objective, group: dist.ProcessGroup | None = None) -> None:
        self.objective, self.group = objective, group

    def __call__(self, position: Float[Tensor, "*batch n_candidate n_dim"]) -> Float[Tensor, "*batch n_candidate"]:
        """The fitness of all candidates, the same on every rank.

        Raises:
            RankLost: if a rank has ended or has not answered within the group's timeout.
            RanksDiffer: if the ranks were given different positions.
            ValueError: if the objective does not return one real number for each place.
        """
        flat = position.reshape(position.shape[:-1].numel(), position.shape[-1])
        size = dist.get_world_size(self.group)
        cuts = shares(len(flat), size)
        longest = max(cut.stop - cut.start for cut in cuts)
        own = flat[cuts[dist.get_rank(self.group)]]
        # One message for both: the fitness, padded to the longest share, and the digest in the bits of one more number.
        message = torch.zeros(longest + 1, dtype=torch.float64, device=flat.device)
        if len(own):
            message[: len(own)] = evaluated(self.objective, own)
        message[longest:] = digest(flat).view(torch.float64)
        heard = message.new_empty(size * len(message))
        try:
            dist.all_gather_single(heard, message, group=self.group)
            heard = heard.reshape(size, longest + 1)
            digests = heard[:, longest].contiguous().view(torch.int64).tolist()
        except RuntimeError as error:
            # The backend's own words without its source line and its advice.
            reason = re.sub(r"^\[[^]]*\]\s*", "", str(error).splitlines()[0]).split(". ")[0].rstrip(".")
            raise RankLost(f"Expected all {size} ranks to answer, but one was lost or silent ({reason}).") from error
        others = [rank for rank, found in enumerate(digests) if found != digests[0]]
        if others:
            raise RanksDiffer(
                f"Expected the same candidates on all {size} ranks, got others on rank {', '.join(map(str, others))} "
                "than on rank 0. Run the same versions of torch and torchplate, on machines of one kind."
            )
        parts = [row[: cut.stop - cut.start] for row, cut in zip(heard, cuts, strict=True)]
        return torch.cat(parts).reshape(position.shape[:-1]).to(position.dtype)


def shares(n_candidate: int, n_rank: int) -> list[slice]:
    """Each rank's part of the candidates: contiguous, in order, cut at multiples of `GRAIN`, as even as that allows."""
    n_block = -(-n_candidate // GRAIN)
    ends = [min(n_candidate, GRAIN * (n_block * rank // n_rank)) for rank in range(n_rank + 1)]
    return [slice(*ends[rank : rank + 2]) for rank in range(n_rank)]


def digest(position: Float[Tensor, "n_candidate n_dim"]) -> Int[Tensor, "1"]:
    """A number that another set of positions has as good as never: Σ bits · odd weight, modulo 2⁶⁴.

    Whole numbers add to the same sum in any order, on any device.
    """
    whole = torch.int64 if position.element_size() == 8 else torch.int32
    bits = position.contiguous().view(whole).flatten().to(torch.int64)
    return (bits * (2 * torch.arange(len(bits), device=bits.device) + 1)).sum(dim=0, keepdim=True)
