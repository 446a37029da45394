"""Processes that share an objective: the same numbers as one, and a clear word when one is lost or has drifted.

The processes are this file, run as a script; each leaves what it has seen in a file. `make check` starts them.
"""

import os
import subprocess
import sys
import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.distributed as dist

from torchplate.search import OPTIMIZERS, RankLost, RanksDiffer, ShardedObjective, minimize
from torchplate.search.sharded import GRAIN, digest, shares

SIZE = 3
# Seconds for what takes three on a machine of its own: beside other work it has taken more than a minute.
PATIENCE = 300
SHAPES = ((1,), (3,), (4,), (5,), (13,), (32,), (2, 7), (3, 1, 6))
DTYPES = (torch.float64, torch.float32)


def positions(shape: tuple[int, ...], dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*shape, 3, dtype=dtype, generator=torch.Generator().manual_seed(7))


def hilly(position: torch.Tensor) -> torch.Tensor:
    """Elementwise, so that no kernel has a choice; no number in one corner."""
    x, y, z = position.unbind(-1)
    value = (x - 0.3) * (x - 0.3) + 2.0 * (y - 0.6) * (y - 0.6) + 3.0 * (z - 0.2) * (z - 0.2)
    return torch.where(x > 0.9, torch.nan, value)


def searched(objective: Any, name: str) -> torch.Tensor:
    """Where a search ends, members and fitness."""
    outcome = minimize(
        objective,
        OPTIMIZERS[name](n_member=10),
        n_dimension=3,
        n_generation=6,
        batch_shape=(2,),
        generator=torch.Generator().manual_seed(3),
    )
    return torch.cat([outcome.population, outcome.fitness[..., None]], dim=-1)


def worker(rank: int, folder: Path) -> None:
    """One of the processes."""
    dist.init_process_group(
        "gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=SIZE, timeout=timedelta(seconds=PATIENCE)
    )
    groups = {size: dist.new_group(list(range(size))) for size in range(1, SIZE + 1)}
    hasty = dist.new_group(timeout=timedelta(seconds=1))
    seen: dict[str, Any] = {}
    for size, group in groups.items():
        if rank >= size:
            continue
        calls: list[torch.Tensor] = []

        def counted(position: torch.Tensor, calls: list[torch.Tensor] = calls) -> torch.Tensor:
            calls.append(position)
            return hilly(position)

        sharded = ShardedObjective(counted, group)
        for shape in SHAPES:
            for dtype in DTYPES:
                calls.clear()
                seen[f"fitness {size} {shape} {dtype}"] = sharded(positions(shape, dtype))
                seen[f"evaluated {size} {shape} {dtype}"] = torch.cat(
                    [positions((0,), dtype), *(call for call in calls)]
                )
        for name in OPTIMIZERS:
            seen[f"search {size} {name}"] = searched(sharded, name)
    other = positions((9,))
    if rank == 1:
        other[4, 2] = other[4, 2].nextafter(torch.ones((), dtype=torch.float64))
    try:
        ShardedObjective(hilly)(other)
    except RanksDiffer as error:
        seen["differ"] = str(error)
    if rank == 1:
        time.sleep(2.0)  # longer than the others' patience
    else:
        seen["silent"] = lost(hasty)
    if rank == 2:
        os._exit(9)
    seen["lost"] = lost(None)
    torch.save(seen, folder / f"{rank}.pt")


def lost(group: dist.ProcessGroup | None) -> str:
    try:
        ShardedObjective(hilly, group)(positions((9,)))
    except RankLost as error:
        return str(error)
    return "nothing"


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What each process has seen; the last one has ended before it could tell."""
    folder = tmp_path_factory.mktemp("ranks")
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    processes = [
        subprocess.Popen([sys.executable, __file__, str(rank), str(folder)], env=environment) for rank in range(SIZE)
    ]
    try:
        assert [process.wait(timeout=PATIENCE) for process in processes] == [0, 0, 9]
    finally:
        for process in processes:
            process.kill()
    return [torch.load(folder / f"{rank}.pt") for rank in range(SIZE - 1)]


@pytest.mark.check
@pytest.mark.parametrize("dtype", DTYPES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("size", range(1, SIZE + 1))
def test_every_rank_has_the_fitness_that_one_process_finds(seen, size, shape, dtype):
    position = positions(shape, dtype)
    expected = hilly(position)
    expected = torch.where(expected.isnan(), torch.inf, expected)
    for rank in range(min(size, SIZE - 1)):
        found = seen[rank][f"fitness {size} {shape} {dtype}"]
        assert found.dtype == dtype
        assert torch.equal(found, expected)


@pytest.mark.check
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("size", [1, 2])
def test_each_candidate_is_evaluated_on_one_rank_alone(seen, size, shape):
    shares_of = [seen[rank][f"evaluated {size} {shape} torch.float64"] for rank in range(size)]
    assert torch.equal(torch.cat(shares_of), positions(shape).flatten(0, -2))
    if size == 2 and positions(shape).shape[:-1].numel() > GRAIN:
        assert min(len(share) for share in shares_of) > 0


@pytest.mark.check
@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize("size", range(1, SIZE + 1))
def test_every_search_ends_where_it_ends_alone(seen, size, name):
    alone = searched(hilly, name)
    for rank in range(min(size, SIZE - 1)):
        assert torch.equal(seen[rank][f"search {size} {name}"], alone)


@pytest.mark.check
def test_ranks_that_differ_in_one_bit_are_told_on_every_rank(seen):
    for rank in range(SIZE - 1):
        assert "got others on rank 1 than on rank 0." in seen[rank]["differ"]


@pytest.mark.check
def test_a_rank_that_is_silent_is_lost(seen):
    assert "Expected all 3 ranks to answer, but one was lost or silent" in seen[0]["silent"]


@pytest.mark.check
def test_a_rank_that_has_ended_is_lost(seen):
    # Rank 1 may first miss rank 0, which goes when it has missed rank 2.
    for rank in range(SIZE - 1):
        assert seen[rank]["lost"].startswith("Expected all 3 ranks to answer, but one was lost or silent (")


@pytest.mark.parametrize("n_rank", [1, 2, 3, 7])
@pytest.mark.parametrize("n_candidate", [1, 4, 9, 32, 45, 100])
def test_shares_are_cut_at_the_grain_and_are_as_even_as_it_allows(n_candidate, n_rank):
    cuts = shares(n_candidate, n_rank)
    assert [index for cut in cuts for index in range(n_candidate)[cut]] == list(range(n_candidate))
    assert all(cut.start % GRAIN == 0 or cut.start == n_candidate for cut in cuts)
    n_block = [-(-(cut.stop - cut.start) // GRAIN) for cut in cuts]
    assert max(n_block) - min(n_block) <= 1


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_the_digest_sees_one_bit_and_the_order(dtype):
    position = positions((6,), dtype)
    changed, swapped = position.clone(), position.flip(0)
    changed[5, 1] = changed[5, 1].nextafter(torch.zeros((), dtype=dtype))
    assert len({int(digest(each)) for each in (position, changed, swapped)}) == 3
    assert int(digest(position)) == int(digest(position.clone()))


def test_an_objective_of_the_wrong_shape_is_refused_before_anything_is_sent(tmp_path):
    dist.init_process_group("gloo", init_method=f"file://{tmp_path}/meet", rank=0, world_size=1)
    try:
        with pytest.raises(ValueError, match="one value per candidate"):
            ShardedObjective(lambda position: position)(positions((5,)))
        assert torch.equal(ShardedObjective(hilly)(positions((2, 3))), hilly(positions((2, 3))).nan_to_num(torch.inf))
    finally:
        dist.destroy_process_group()


if __name__ == "__main__":
    worker(int(sys.argv[1]), Path(sys.argv[2]))
    # All other references to the groups are gone, so their threads end here: one that still lets go of a tensor while
    # the interpreter ends aborts the process.
    dist.destroy_process_group()
