"""What may be missing as a table sees it: every effect with its options tried all over its intervals, and pairs.

`tried` evaluates each candidate at places spread over its intervals, beside the fitted given model. That says which
effects this table cannot see, where refits begin, and, with the changes of two effects added, which pairs promise most.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.candidates.channels import Channels
from torchplate.diagnosis.candidates.trials import holes_all_over
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.refit import Minimum, Problem
from torchplate.diagnosis.table.settings import TableSettings
from torchplate.effects import CATALOGUE


@dataclass(frozen=True, eq=False)
class Tried:
    """A candidate at many places.

    Attributes:
        candidate: the effect with its options.
        index: of the candidate.
        own: its parameters there, on the unit cube.
        change: of the residuals, freed of what the fitted parameters can do.
        whole: of the residuals as they change.
        modes: of its own, that join the basis.
    """

    candidate: Candidate
    index: int
    own: Float[Tensor, "n_place n_own"]
    change: Float[Tensor, "n_place n_residual"]
    whole: Float[Tensor, "n_place n_residual"]
    modes: tuple[Tensor, ...]

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.candidate.name

    def seen(self, settings: TableSettings) -> bool:
        """Whether the table can see it at all."""
        return bool(len(self.change)) and float(self.change.square().sum(-1).max()) > settings.unseen


@dataclass(frozen=True, eq=False)
class Fitted:
    """The given model, fitted, and what its parameters can do to the residuals.

    Attributes:
        minimum: of its own problem.
        residual: with what is known beforehand.
        slope: of those on the unit cube.
    """

    minimum: Minimum
    residual: Float[Tensor, " n_residual"]
    slope: Float[Tensor, "n_residual n"]

    @classmethod
    def of(cls, problem: Problem, minimum: Minimum) -> "Fitted":
        """At a minimum."""
        place = minimum.position
        off = torch.cat([problem.evidence.residual(minimum.predicted), problem.deviations(place)])
        slope = torch.cat(
            [problem.natural.slope(place[None])[0] / problem.evidence.std[:, None], problem.known_slope(place)]
        )
        return cls(minimum, off, slope)

    def freed(self, change: Float[Tensor, "*n n_residual"]) -> Float[Tensor, "*n n_residual"]:
        """What is left of a change when the fitted parameters follow it."""
        if not self.slope.shape[-1]:
            return change
        left, strength, _ = torch.linalg.svd(self.slope, full_matrices=False)
        basis = left[:, strength > 1e-9 * strength.max().clamp(min=1e-300)]
        return change - (change @ basis) @ basis.mT

    def following(self, change: Float[Tensor, " n_residual"]) -> Float[Tensor, " n"]:
        """Where the fitted parameters go with a change."""
        if not self.slope.shape[-1]:
            return self.minimum.position
        step = torch.linalg.pinv(self.slope, rtol=1e-9) @ (self.residual + change)
        return (self.minimum.position - step).clamp(0.0, 1.0)


def visible(plates: Plates, theta: Float[Tensor, " n"]) -> list[Candidate]:
    """Every candidate whose effect undamped natural frequencies can see, with the parameters that they can see."""
    every = candidates(plates.model, theta, Channels((), ()))
    return [one for one in every if CATALOGUE[one.name].moves_natural_frequencies()]


def label_of(name: str, number: int = 1) -> str:
    """Of an effect that is added."""
    return f"{name}_{number}"


def tried(plates: Plates, fitted: Fitted, index: int, candidate: Candidate, settings: TableSettings) -> Tried:
    """A candidate spread over its intervals, the given model's parameters where they were fitted.

    Its details (a patch's aspect) are neutral here, and every refit looks for them.
    """
    evidence, label = plates.evidence, label_of(candidate.name)
    n, details, candidate = len(candidate.searched), {*candidate.detail}, candidate.in_detail()
    model = plates.with_effects([candidate], [label])
    keys = [name.removeprefix(f"{label}.") if name.startswith(f"{label}.") else "" for name in model.names]
    own = [k for k, key in enumerate(keys) if key]
    rest = [k for k, key in enumerate(keys) if not key]
    count = settings.n_library * (1 if n == 1 else 4 if n == 2 else 8)
    still = model.space.to_si(model.known.new_full((len(keys),), 0.5))
    for key in details:
        still[keys.index(key)] = candidate.neutral[key]
    still, spread = model.space.to_cube(still)[own], [k for k, j in enumerate(own) if keys[j] not in details]

    def detailed(some: Tensor) -> Tensor:
        found = still.repeat(len(some), 1)
        found[:, spread] = some.to(found)
        return found

    def whole(some: Tensor) -> Tensor:
        found = some.new_empty(len(some), len(model.names))
        found[:, own], found[:, rest] = some, fitted.minimum.position
        return found

    places = detailed(torch.cat([SobolEngine(n).draw(count, dtype=torch.float64)[1:], *_corners(n)]))
    if candidate.is_hole:
        holes = [[one[keys[k]] for k in own] for one in holes_all_over(count)]
        middle = model.space.to_si(model.known.new_full((count, len(keys)), 0.5))
        middle[:, own] = middle.new_tensor(holes)
        places = model.space.to_cube(middle)[:, own]
    modes: list[Tensor] = []
    natural = plates.reduced(model)
    if not candidate.has_place:
        # Far members show whether the shared modes do; where they do not, those of these members join.
        for place in _corners(n):
            for member in whole(detailed(place)):
                theta = model.space.to_si(member)
                exact = plates.solved(model, theta)
                off = (
                    (natural.frequency(member[None])[0] / exact.frequency[plates.mode].clamp(min=1e-9) - 1).abs().max()
                )
                if float(off) > settings.basis_error:
                    modes.append(exact.shape)
        if modes:
            natural = plates.reduced(model, modes)
    predicted = natural.frequency(whole(places))
    plates.n_evaluation += len(places)
    change = (predicted - fitted.minimum.predicted) / evidence.std
    change = torch.cat([change, change.new_zeros(len(change), len(fitted.residual) - evidence.n)], dim=-1)
    sound = change.isfinite().all(-1)
    places, change = places[sound], change[sound]
    return Tried(candidate, index, places, fitted.freed(change), change, tuple(modes))


def _corners(n: int) -> list[Tensor]:
    """The ends of a candidate's intervals: all high, and for two parameters the first alone and all low too."""
    ends = [[1.0] * n]
    if n <= 2:
        ends += [[0.0] * n]
    if n == 2:
        ends += [[1.0, 0.0], [0.0, 1.0]]
    return [torch.tensor(ends, dtype=torch.float64)]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects that may be missing together, and where their refit begins.

    Attributes:
        parts: of the candidates tried.
        starts: parameters of each effect in turn and of the given model, on the unit cube.
        promise: least sum of squares at the starts, the fitted parameters following.
    """

    parts: tuple[Tried, ...]
    starts: Float[Tensor, "n_start n"]
    promise: float

    @property
    def key(self) -> tuple[int, ...]:
        """Of its candidates."""
        return tuple(part.index for part in self.parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Of its effects."""
        return tuple(part.name for part in self.parts)

    @property
    def labels(self) -> tuple[str, ...]:
        """Of its effects in the model."""
        return tuple(
            label_of(name, 1 + sum(other == name for other in self.names[:k])) for k, name in enumerate(self.names)
        )


def is_simpler(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether a hypothesis is another with a simpler effect in place of one that becomes it (`Effect.contains`)."""

    def without(hypothesis: Hypothesis, part: Tried) -> list[int]:
        rest = list(hypothesis.key)
        rest.remove(part.index)
        return sorted(rest)

    return any(
        simple.name in part.candidate.effect.contains and without(one, simple) == without(other, part)
        for part in other.parts
        for simple in one.parts
    )


def single(fitted: Fitted, part: Tried, settings: TableSettings) -> Hypothesis:
    """One effect alone, begun where it promises most and at places apart from those."""
    square = fitted.freed(fitted.residual + part.change).square().sum(-1)
    chosen = _apart(part.own, square.argsort().tolist(), settings.n_start)
    return Hypothesis((part,), _starts(fitted, (part,), [(k,) for k in chosen]), float(square.min()))


@dataclass(frozen=True, eq=False)
class Alone:
    """One effect as it was refitted alone.

    Attributes:
        part: the candidate.
        fitted: the model with it, where its refit has ended.
        own: which of that model's parameters are the effect's.
        given: for each parameter of the given model which of them it is; None where the effect stands for it.
    """

    part: Tried
    fitted: Fitted
    own: tuple[int, ...]
    given: tuple[int | None, ...]

    def beside(self, other: Tried, given: Fitted, count: int) -> list[tuple[float, Tensor, Tensor, Tensor]]:
        """Starts of both: this one where it was refitted, the other where it promises most beside that.

        What the other changes is taken for the same as beside the given model.

        Returns:
            Of each the sum of squares that is expected, this one's parameters, the other's and the given model's.
        """
        square = self.fitted.freed(self.fitted.residual + other.whole).square().sum(-1)
        found = []
        for k in _apart(other.own, square.argsort().tolist(), count):
            place = self.fitted.following(other.whole[k])
            rest = given.minimum.position.clone()
            for j, column in enumerate(self.given):
                if column is not None:
                    rest[j] = place[column]
            found.append((float(square[k]), place[list(self.own)], other.own[k], rest))
        return found


def pairs(
    fitted: Fitted, parts: Sequence[Tried], settings: TableSettings, alone: Sequence[Alone] = ()
) -> list[Hypothesis]:
    """The pairs that promise most: the changes of both effects added, or one where its refit alone has ended.

    Far from the given model changes do not add up: an edge that is held moves every mode, and what a taper does is to
    be seen beside it. Half of the starts are of either kind.
    """
    refitted = {one.part.index: one for one in alone}
    found = []
    for one, other in _combinations(parts):
        first = fitted.freed(fitted.residual + one.change)
        # |r + a + b|² of all combinations in one product.
        square = first.square().sum(-1)[:, None] + other.change.square().sum(-1) + 2 * first @ other.change.mT
        order = square.flatten().argsort()[: 20 * settings.n_start].tolist()
        places = [(k // square.shape[1], k % square.shape[1]) for k in order]
        both = torch.stack([torch.cat([one.own[a], other.own[b]]) for a, b in places])
        beside = [(e, torch.cat([a, b, c])) for e, a, b, c in _beside(refitted, one, other, fitted, settings)]
        if one is not other:
            more = _beside(refitted, other, one, fitted, settings)
            beside = sorted([*beside, *((e, torch.cat([b, a, c])) for e, a, b, c in more)], key=lambda start: start[0])
        beside = beside[: settings.n_start // 2]
        chosen = _apart(both, list(range(len(places))), settings.n_start - len(beside))
        starts = _starts(fitted, (one, other), [places[k] for k in chosen])
        promise = min([float(square.min()), *(start[0] for start in beside)])
        found.append(Hypothesis((one, other), torch.stack([*starts, *(start[1] for start in beside)]), promise))
    return sorted(found, key=lambda one: one.promise)


def _beside(
    refitted: Mapping[int, Alone], one: Tried, other: Tried, fitted: Fitted, settings: TableSettings
) -> list[tuple[float, Tensor, Tensor, Tensor]]:
    own = refitted.get(one.index)
    return [] if own is None else own.beside(other, fitted, settings.n_start // 2)


def _combinations(parts: Sequence[Tried]) -> Iterator[tuple[Tried, Tried]]:
    """All pairs that can be missing together; two of a kind where these sit at places."""
    for k, one in enumerate(parts):
        for other in parts[k:]:
            if one is other and not one.candidate.has_place:
                continue
            if one.candidate.replaces and one.candidate.replaces == other.candidate.replaces:
                continue
            yield one, other


def _apart(places: Tensor, order: Sequence[int], count: int) -> list[int]:
    """The first of an order that are not near one another."""
    kept: list[int] = []
    for k in order:
        if all(float((places[k] - places[j]).abs().max()) > 0.15 for j in kept):
            kept.append(k)
        if len(kept) == count:
            break
    return kept


def _starts(fitted: Fitted, parts: Sequence[Tried], chosen: Sequence[Sequence[int]]) -> Tensor:
    rows = []
    for places in chosen:
        change = sum(part.whole[k] for part, k in zip(parts, places, strict=True))
        assert isinstance(change, Tensor)
        own = [part.own[k] for part, k in zip(parts, places, strict=True)]
        rows.append(torch.cat([*own, fitted.following(change)]))
    return torch.stack(rows)


def ordered(hypothesis: Hypothesis, model_names: Sequence[str], given_names: Sequence[str]) -> list[int]:
    """For each parameter of the model with the effects its column among the starts."""
    columns = [
        f"{label}.{name}"
        for label, part in zip(hypothesis.labels, hypothesis.parts, strict=True)
        for name in part.candidate.effect.parameters
        if name in part.candidate.searched
    ] + list(given_names)
    return [columns.index(name) for name in model_names]
