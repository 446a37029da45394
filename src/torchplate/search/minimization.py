"""The loop that every optimiser shares: evaluate, count, stop, report, resume."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchplate.search.optimizer import Optimizer, without_nan
from torchplate.search.outcome import Checkpoint, Outcome, Progress, Status

Objective = Callable[[Tensor], Tensor]
"""Positions [*batch, n_candidate, n_dimension] in [0, 1] → fitness [*batch, n_candidate]."""

_STATUSES = list(Status)
_RUNNING = -1


class _Ledger(NamedTuple):
    """What the loop knows of each search, beside the optimiser's own state; all tensors of shape [*batch]."""

    n_evaluation: Int[Tensor, "*batch"]
    n_generation: Int[Tensor, "*batch"]
    status: Int[Tensor, "*batch"]
    n_idle: Int[Tensor, "*batch"]
    last_best: Float[Tensor, "*batch"]

    @property
    def running(self) -> Bool[Tensor, "*batch"]:
        return self.status == _RUNNING

    def stopped(self, where: Tensor, status: Status) -> "_Ledger":
        code = torch.where(self.running & where, _STATUSES.index(status), self.status)
        return self._replace(status=code)


@torch.no_grad()
def minimize(
    objective: Objective,
    optimizer: Optimizer[Any],
    *,
    n_dimension: int,
    generator: torch.Generator,
    batch_shape: Sequence[int] = (),
    n_generation: int | None = None,
    n_evaluation: int | None = None,
    target: float | None = None,
    tolerance: float | None = 1e-8,
    stagnation: int | None = None,
    dtype: torch.dtype = torch.float64,
    device: torch.device | str | None = None,
    initial: Float[Tensor, "*batch n_member n_dimension"] | None = None,
    on_generation: Callable[[Progress], object] | None = None,
    resume: Checkpoint | None = None,
) -> Outcome:
    """Minimise an objective over the unit cube.

    A search that has stopped is frozen: it changes no more and spends no evaluations, while the others of its
    batch go on. (The objective is still called with the whole batch; what it says of a stopped search is
    ignored.)

    Args:
        objective: Any function of torch tensors: positions [*batch, n_candidate, n_dimension] in [0, 1] →
            fitness [*batch, n_candidate]. NaN counts as +inf.
        optimizer: The settings of the search.
        n_dimension: Dimensions of the unit cube.
        generator: Source of all randomness. The whole batch draws from this one stream.
        batch_shape: Shape of the independent searches; () is one search.
        n_generation: Generations at most.
        n_evaluation: Evaluations at most for each search, the initial population included; never exceeded: a
            generation that would go beyond it is not begun.
        target: A search stops as soon as its best objective is at or below this value.
        tolerance: A search stops when the standard deviation of its members' fitness is at most this times
            the absolute mean; None never stops for this. (1e-8 is the square root of what float64 resolves:
            near a smooth minimum the members then differ by 1e-4 of the objective's own length scale, which
            is also where differences of the objective begin to drown in rounding.)
        stagnation: A search stops after this many generations without improvement; None never does.
        dtype: Of positions and fitness.
        device: Of positions and fitness; that of the generator if left out.
        initial: The first population; drawn evenly over the cube if left out.
        on_generation: Called with a `Progress` after the initial population and after each generation.
        resume: What `Progress.checkpoint` gave. The result is identical to that of the search it was taken
            from. A search that stopped for its budget goes on if the budget is now larger.

    Returns:
        The best place of each search, what it cost and why it stopped.

    Raises:
        ValueError: No budget, a budget below the initial population, a population or fitness of the wrong
            shape, or a checkpoint of another search.
    """
    device = torch.device(device) if device is not None else generator.device
    shape = (*batch_shape, optimizer.n_member, n_dimension)
    _check_budget(optimizer, n_generation, n_evaluation)
    if device.type != generator.device.type:
        raise ValueError(
            f"The generator must live on the search's device, {device.type}, got one on "
            f"{generator.device.type}. Make it with torch.Generator(device={device.type!r})."
        )
    optimizer = optimizer.planned(n_evaluation, n_generation)

    if resume is None:
        state, ledger = _begin(objective, optimizer, shape, initial, generator, dtype, device)
        generation = 0
        ledger = _judged(ledger, state, target=target, tolerance=tolerance)
        _report(on_generation, generation, state, ledger, optimizer, generator)
    else:
        state, ledger, generation = _resumed(resume, optimizer, shape, generator, dtype, device)
        ledger = _judged(ledger, state, target=target)

    while n_generation is None or generation < n_generation:
        if not bool(ledger.running.any()):
            break
        before = ledger
        for _ in range(optimizer.n_phase):
            state, ledger = _phase(objective, optimizer, state, ledger, n_evaluation, generator)
            finished = ledger.running
            ledger = _judged(ledger, state, target=target)
        ledger = _counted(ledger, state, finished)
        ledger = _judged(ledger, state, tolerance=tolerance, stagnation=stagnation)
        if torch.equal(ledger.n_evaluation, before.n_evaluation):
            break
        generation += 1
        _report(on_generation, generation, state, ledger, optimizer, generator)

    return _outcome(state, ledger)


def _begin(
    objective: Objective,
    optimizer: Optimizer[Any],
    shape: tuple[int, ...],
    initial: Tensor | None,
    generator: torch.Generator,
    dtype: torch.dtype,
    device: torch.device,
) -> tuple[Any, _Ledger]:
    if initial is None:
        population = torch.rand(shape, generator=generator, dtype=dtype, device=device)
    else:
        population = initial.to(dtype=dtype, device=device)
        if population.shape != shape:
            raise ValueError(
                f"initial must have shape [*batch, n_member, n_dimension] = {list(shape)}, got "
                f"{list(population.shape)}. Change initial, batch_shape, or the optimiser's n_member."
            )
        if not bool(((population >= 0.0) & (population <= 1.0)).all()):
            raise ValueError("initial must lie on the unit cube, got members outside [0, 1]. Scale it first.")
    state = optimizer.init(population, evaluated(objective, population))
    batch = shape[:-2]
    zero = torch.zeros(batch, dtype=torch.int64, device=device)
    ledger = _Ledger(zero + shape[-2], zero, zero + _RUNNING, zero, state.best_objective)
    return state, ledger


def _phase(
    objective: Objective,
    optimizer: Optimizer[Any],
    state: Any,
    ledger: _Ledger,
    n_evaluation: int | None,
    generator: torch.Generator,
) -> tuple[Any, _Ledger]:
    """One ask and tell for the searches that run and can pay for it."""
    candidates, asked = optimizer.ask(state, generator)
    price = candidates.active.sum(dim=-1)
    if n_evaluation is not None:
        ledger = ledger.stopped(ledger.n_evaluation + price > n_evaluation, Status.budget)
    running = ledger.running
    candidates = candidates._replace(active=candidates.active & running.unsqueeze(-1))
    if bool(candidates.active.any()):
        fitness = evaluated(objective, candidates.position)
    else:
        fitness = candidates.position.new_full(candidates.active.shape, torch.inf)
    return optimizer.tell(asked, candidates, fitness), ledger._replace(
        n_evaluation=ledger.n_evaluation + price * running
    )


def evaluated(objective: Objective, position: Tensor) -> Tensor:
    """What an objective says of some places, in their dtype; NaN is +inf.

    Raises:
        ValueError: The objective does not return one real number for each place.
    """
    fitness = objective(position)
    if fitness.shape != position.shape[:-1]:
        raise ValueError(
            f"The objective must return one value per candidate, shape {list(position.shape[:-1])}, got "
            f"{list(fitness.shape)}. Reduce over the last dimension of the positions only."
        )
    if fitness.is_complex():
        raise ValueError(
            "The objective must return real numbers, got complex ones. Take the absolute value or the norm."
        )
    return without_nan(fitness.detach().to(position))


def _counted(ledger: _Ledger, state: Any, finished: Tensor) -> _Ledger:
    """One generation more for the searches that ran to its end."""
    best = state.best_objective
    idle = torch.where(best < ledger.last_best, 0, ledger.n_idle + 1)
    return ledger._replace(
        n_generation=ledger.n_generation + finished.to(torch.int64),
        n_idle=torch.where(finished, idle, ledger.n_idle),
        last_best=torch.where(finished, best, ledger.last_best),
    )


def _judged(
    ledger: _Ledger,
    state: Any,
    *,
    target: float | None = None,
    tolerance: float | None = None,
    stagnation: int | None = None,
) -> _Ledger:
    if target is not None:
        ledger = ledger.stopped(state.best_objective <= target, Status.target)
    if tolerance is not None:
        deviation = state.fitness.std(dim=-1, correction=0)
        ledger = ledger.stopped(deviation <= tolerance * state.fitness.mean(dim=-1).abs(), Status.tolerance)
    if stagnation is not None:
        ledger = ledger.stopped(ledger.n_idle >= stagnation, Status.stagnation)
    return ledger


def _report(
    on_generation: Callable[[Progress], object] | None,
    generation: int,
    state: Any,
    ledger: _Ledger,
    optimizer: Optimizer[Any],
    generator: torch.Generator,
) -> None:
    if on_generation is None:
        return
    finite = torch.where(state.fitness.isfinite(), state.fitness, torch.nan)
    snapshot = {
        "optimizer": torch.tensor(list(optimizer.name.encode()), dtype=torch.uint8),
        "generator": generator.get_state(),
        "generation": torch.tensor(generation),
    }
    snapshot |= {f"state.{key}": value for key, value in state._asdict().items()}
    snapshot |= {f"ledger.{key}": value for key, value in ledger._asdict().items()}
    on_generation(
        Progress(
            generation=generation,
            n_evaluation=ledger.n_evaluation,
            best_position=state.best_position,
            best_objective=state.best_objective,
            mean_objective=finite.nanmean(dim=-1),
            spread=state.population.std(dim=-2, correction=0).mean(dim=-1),
            snapshot=snapshot,
        )
    )


def _resumed(
    resume: Checkpoint,
    optimizer: Optimizer[Any],
    shape: tuple[int, ...],
    generator: torch.Generator,
    dtype: torch.dtype,
    device: torch.device,
) -> tuple[Any, _Ledger, int]:
    made_by = bytes(resume["optimizer"].tolist()).decode()
    if made_by != optimizer.name:
        raise ValueError(
            f"The checkpoint must come from {optimizer.name}, got one of {made_by}. "
            f"Resume with {made_by}, or start without a checkpoint."
        )
    found = resume["state.population"].shape
    if (*found[:-2], found[-1]) != (*shape[:-2], shape[-1]):
        raise ValueError(
            f"The checkpoint must hold searches of shape {list(shape[:-2])} in {shape[-1]} dimensions, got "
            f"{list(found[:-2])} in {found[-1]}. Give the batch_shape and n_dimension it was made with."
        )

    def on_device(value: Tensor) -> Tensor:
        return value.to(device=device, dtype=dtype if value.is_floating_point() else None)

    state = optimizer.state_type(**{k: on_device(resume[f"state.{k}"]) for k in optimizer.state_type._fields})
    ledger = _Ledger(**{k: on_device(resume[f"ledger.{k}"]) for k in _Ledger._fields})
    spent = ledger.status == _STATUSES.index(Status.budget)
    ledger = ledger._replace(status=torch.where(spent, _RUNNING, ledger.status))
    generator.set_state(resume["generator"].cpu())
    return state, ledger, int(resume["generation"])


def _check_budget(optimizer: Optimizer[Any], n_generation: int | None, n_evaluation: int | None) -> None:
    if n_generation is None and n_evaluation is None:
        raise ValueError("A search needs a budget, got none. Give n_generation, n_evaluation or both.")
    if n_generation is not None and n_generation < 0:
        raise ValueError(f"n_generation must be 0 or more, got {n_generation}. Give a positive number.")
    if n_evaluation is not None and n_evaluation < optimizer.n_member:
        raise ValueError(
            f"n_evaluation must pay for the initial population of {optimizer.n_member}, got {n_evaluation}. "
            f"Raise it or lower n_member."
        )


def _outcome(state: Any, ledger: _Ledger) -> Outcome:
    ledger = ledger.stopped(torch.ones_like(ledger.running), Status.budget)
    lost = _STATUSES.index(Status.no_number)
    code = torch.where(state.best_objective == math.inf, lost, ledger.status)
    return Outcome(
        best_position=state.best_position,
        best_objective=state.best_objective,
        n_evaluation=ledger.n_evaluation,
        n_generation=ledger.n_generation,
        status=tuple(_STATUSES[k] for k in code.flatten().tolist()),
        population=state.population,
        fitness=state.fitness,
    )
