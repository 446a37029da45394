"""What may be missing as a table sees it: every effect with its options tried all over its intervals, and pairs.

`tried` evaluates each candidate at places spread over its intervals, beside the fitted given model. That says which
effects this table cannot see, where refits begin, and, with the changes of two effects added, which pairs promise most.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.candidates.channels import Channels
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
    """A candidate spread over its intervals, the given model's parameters where they were fitted."""
    evidence, label = plates.evidence, label_of(candidate.name)
    model = plates.with_effects([candidate], [label])
    own = [k for k, name in enumerate(model.names) if name.startswith(f"{label}.")]
    rest = [k for k in range(len(model.names)) if k not in own]
    n = len(own)
    count = settings.n_library * (1 if n == 1 else 4 if n == 2 else 8)
    places = torch.cat([SobolEngine(n).draw(count, dtype=torch.float64)[1:], *_corners(n)]).to(model.known)

    def whole(some: Tensor) -> Tensor:
        found = some.new_empty(len(some), len(model.names))
        found[:, own], found[:, rest] = some, fitted.minimum.position
        return found

    modes: list[Tensor] = []
    natural = plates.reduced(model)
    if not candidate.has_place:
        # Far members show whether the shared modes do; where they do not, those of these members join.
        for place in _corners(n):
            for member in whole(place.to(model.known)):
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


def single(fitted: Fitted, part: Tried, settings: TableSettings) -> Hypothesis:
    """One effect alone, begun where it promises most and at places apart from those."""
    square = fitted.freed(fitted.residual + part.change).square().sum(-1)
    chosen = _apart(part.own, square.argsort().tolist(), settings.n_start)
    return Hypothesis((part,), _starts(fitted, (part,), [(k,) for k in chosen]), float(square.min()))


def pairs(fitted: Fitted, parts: Sequence[Tried], settings: TableSettings) -> list[Hypothesis]:
    """The pairs that promise most, the changes of both effects added."""
    found = []
    for one, other in _combinations(parts):
        first = fitted.freed(fitted.residual + one.change)
        # |r + a + b|² of all combinations in one product.
        square = first.square().sum(-1)[:, None] + other.change.square().sum(-1) + 2 * first @ other.change.mT
        order = square.flatten().argsort()[: 20 * settings.n_start].tolist()
        places = [(k // square.shape[1], k % square.shape[1]) for k in order]
        both = torch.stack([torch.cat([one.own[a], other.own[b]]) for a, b in places])
        chosen = _apart(both, list(range(len(places))), settings.n_start)
        starts = _starts(fitted, (one, other), [places[k] for k in chosen])
        found.append(Hypothesis((one, other), starts, float(square.min())))
    return sorted(found, key=lambda one: one.promise)


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
