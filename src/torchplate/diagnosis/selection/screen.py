"""The score test: what each effect would take from the gap, before any of them is refitted.

Every candidate is tried at all its places and a few sizes in one batch. With r the residuals of the baseline, δ the
change that a member makes and both freed of what the fitted parameters can do (P projects out their Jacobian), the best
multiple α of the change takes

    drop = (2 α rᵀδ − α² δᵀδ) / rᵀr,    α = rᵀδ / δᵀδ within its limits,

from the squared misfit: the score test of statistics, with a finite step; structural equation modelling prints it as
modification index and expected parameter change (Sörbom, Psychometrika 54, 1989, 371).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate, Trial, distance, vector
from torchplate.diagnosis.candidates.trials import as_large
from torchplate.diagnosis.freed_memory import hand_back
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.diagnosis.selection.null import Draws, falls
from torchplate.diagnosis.selection.products import Product, Products, best_of_places, most_of_the_mesh
from torchplate.diagnosis.settings import SETTINGS
from torchplate.discrepancy import Marginal
from torchplate.model import PlateModel, on_mesh
from torchplate.search import JACOBIANS

# Residuals of all members that are scored together: 8 MiB.
NUMBERS_AT_ONCE = 2**20


class Scored(NamedTuple):
    """A candidate and what it promises.

    Attributes:
        candidate: the effect with its options.
        label: that it would get.
        model: the baseline with it, in the shared basis.
        drop: part of the squared misfit that its best member would take away.
        values: of that member, after the best multiple of its change.
        starts: on the unit cube of `model`, the best first.
        signature: direction of its change, unit length.
        by_chance: what it would take from the sum of squares of each draw in which nothing is missing.
        by_mesh: what it would take from that of what the mesh may have left.
        by_chance_at_most: what chance lets it take; 0 where so much is left that it was not asked.
    """

    candidate: Candidate
    label: str
    model: PlateModel
    drop: float
    values: Mapping[str, float]
    starts: Float[Tensor, "n_start n"]
    signature: Float[Tensor, " n_residual"]
    by_chance: Float[Tensor, " n_draw"]
    by_mesh: float = 0.0
    by_chance_at_most: float = 0.0


def screen(
    builder: ModelBuilder,
    base: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    everyone: Sequence[Candidate],
    prior: Prior,
    near: Marginal | None = None,
    draws: Draws | None = None,
    says: Complex[Tensor, "n_frequency n_response n_reference"] | None = None,
    mesh: Complex[Tensor, "n_frequency n_response n_reference"] | None = None,
) -> list[Scored]:
    """Score all candidates, the most promising first.

    Args:
        builder: what evaluates them.
        base: the baseline in a basis that the candidates share.
        theta: its fitted parameters.
        everyone: the candidates.
        prior: what is known of the baseline's parameters beforehand.
        near: noise and nuisances beside the baseline, where it is nearly right, so that peaks overlap: candidates are
            then scored at the sharp level, by small steps; None elsewhere.
        draws: residuals at the sharp level that chance makes, to be scored too.
        says: what the baseline is better known to say; left out, what it says in the basis. Changes beside it are those
            of the basis.
        mesh: change of the FRFs that their mesh may have left; None for none, and where peaks do not overlap.
    """
    hand_back(builder.target.measured.nbytes)
    level = builder.target.levels - 1 if near is not None else builder.target.settings.wide.screened
    here = Problem(builder, base, prior, near)
    position = base.space.to_cube(theta)
    plain = here.predict(theta, level)
    own = here.deviations(plain, theta, level)
    residual = own if says is None else here.deviations(says, theta, level)
    # What ended on the edge of its interval is not free to do anything more.
    loose = ~base.space.at_bound(theta)
    # What a candidate does beyond them may be a small part of what it does: they have to be known so much better.
    differences = "forward" if near is None else "central"
    if bool(loose.any()):
        jacobian = JACOBIANS[differences].differentiate(lambda p: here.residual(p, level), position[None], own[None])
        tangent = jacobian[0][:, loose]
        norm = tangent.norm(dim=0).clamp(min=1e-300)
        known, upper = torch.linalg.qr(tangent / norm)
    else:
        known, upper, norm = residual.new_zeros(len(residual), 0), residual.new_zeros(0, 0), residual.new_zeros(0)

    n_told = len(here.told(theta))
    left = residual - (residual @ known) @ known.mT
    left_by_mesh = None if mesh is None or near is None else near.over_noise(mesh)
    products = Products(near, left, known, draws, len(residual) - n_told, left_by_mesh)
    # What whitening took, of draws above all.
    hand_back(builder.target.measured.nbytes)
    felt = known.mT @ residual

    def makes_room(taken: Tensor) -> Tensor:
        """Where the fitted parameters go, to first order, when a candidate takes so much of what they can do."""
        if near is None or not bool(loose.any()):
            return theta
        step = torch.zeros_like(position)
        step[loose] = torch.linalg.lstsq(upper, (felt - taken)[:, None], driver="gelsd").solution[:, 0] / norm
        return base.space.to_si((position - step).clamp(0.0, 1.0))

    total = float(left.square().sum())
    even = base if base.assembly.unevenness is None else on_mesh(base, base.assembly.uneven(None))
    found = []
    for candidate in everyone:
        label = new_label(base, candidate.name)
        # A plate with a hole is even elsewhere: what it changes is that beside one without.
        around = even if candidate.is_hole else base
        model = with_candidate(around, label, candidate)
        trials = candidate.near if near is not None else candidate.far
        before = plain if around is base else Problem(builder, even, prior, near).predict(theta, level)
        changes = _Changes(here, Problem(builder, model, prior, near), theta, before, level)
        with torch.no_grad():
            exchanged = builder.target.rearranged(plain, base, candidate.effect, level)
            rests = _rests(model, theta, base, trials, label) if near is not None else None
            if exchanged is not None:
                members, changed = theta[None], changes.to(exchanged)[None]
                score, kept = products.of(changed), [0]
                builder.count(1)
            else:
                members = _members(model, theta, base, [trial.values for trial in trials], label)
                scores = []
                for some in torch.arange(len(members)).split(_at_once(left)):
                    changed, kept = changes.of(members[some], None if rests is None else rests[some]), some.tolist()
                    scores.append(products.of(changed))
                score = Product(*(torch.cat(part) for part in zip(*scores, strict=True)))
            if not candidate.is_local:
                if len(kept) < len(members):
                    changed = changes.of(members, rests)
                freed = products.freed(changed)
                # What is left of a change that the fitted parameters nearly undo is lost where squares are subtracted.
                score = score._replace(along=freed @ left, size=freed.square().sum(-1).clamp(min=1e-280))
        # A discrete effect is there or not.
        limits = theta.new_tensor([[trial.lowest, trial.highest] for trial in trials])
        alpha = (score.along / score.size).clamp(limits[:, 0], limits[:, 1])
        alpha = alpha if candidate.searched else torch.ones_like(alpha)
        drop = (2 * alpha * score.along - alpha.square() * score.size) / max(total, 1e-300)
        values = [_moved(candidate, dict(one.values), float(a)) for one, a in zip(trials, alpha, strict=True)]
        chosen = _apart(values, drop)
        rooms = [makes_room(alpha[index] * score.known[index]) for index in chosen]
        begun = [_for_the_own(candidate, values[k], base, theta, room) for k, room in zip(chosen, rooms, strict=True)]
        starts = torch.stack([start_of(model, room, base, own, label) for room, own in zip(rooms, begun, strict=True)])
        if near is not None and candidate.searched:
            # From where the model is, too: with an effect more it cannot end farther off than without.
            starts = torch.cat([starts, start_of(model, theta, base, values[chosen[0]], label)[None]])
        best, least = chosen[0], chosen[0] if candidate.is_local else int(score.size.argmin())
        if candidate.is_local:
            # Of places, one is asked for: the others were not kept.
            change = changed[kept.index(best)] if best in kept else changes.of(members[[best]])[0]
            freed = products.freed(change[None])
        signature = freed[0 if candidate.is_local else least] / score.size[least].sqrt()
        together = candidate.searched and not candidate.is_local
        by_mesh = float(falls(freed, score.mesh[:, None])) if together else most_of_the_mesh(score)
        by_chance = residual.new_zeros(0)
        if draws is not None and candidate.searched:
            by_chance = falls(freed, score.drawn) if together else best_of_places(score)
        promise = float(drop[best]), values[best], starts, signature, by_chance, by_mesh
        found.append(Scored(candidate, label, model, *promise))
    return sorted(found, key=lambda one: -one.drop)


class _Changes:
    """What members of a candidate change in the residuals of a baseline, over the noise or over their size.

    Args:
        here: the baseline.
        there: the candidate beside it.
        theta: parameters of the baseline.
        plain: what it predicts.
        level: of the residuals.
    """

    def __init__(self, here: Problem, there: Problem, theta: Tensor, plain: Tensor, level: int) -> None:
        self._here, self._there, self._theta, self._plain, self._level = here, there, theta, plain, level

    def of(
        self, members: Float[Tensor, "n_member n"], rest: Float[Tensor, "n_member n"] | None = None
    ) -> Float[Tensor, "n_member n_residual"]:
        """Those of members; to first order, where they are tangents that begin at rest."""
        if rest is not None:
            return self._along(rest, members)
        inside = self._there.model.space.to_si(self._there.model.space.to_cube(members))
        return self.to(self._there.predict(inside, self._level))

    def _along(
        self, rest: Float[Tensor, "n_member n"], members: Float[Tensor, "n_member n"]
    ) -> Float[Tensor, "n_member n_residual"]:
        """Those of members to first order: 4 δ(h/2) − δ(h), of which the second order in the step h cancels.

        A step, however small, is not straight. Beside one of the baseline's own numbers that does nearly the same, as a
        thickness beside a modulus, the second order is what would be left of it.
        """
        return 4 * self.of(0.5 * (rest + members)) - self.of(members)

    def to(self, prediction: Tensor) -> Tensor:
        """Those of predictions: the FRFs change, what is known beforehand does not."""
        near, target = self._here.marginal, self._here.target
        if near is not None:
            return near.over_noise(prediction - self._plain)
        return target.residual(self._plain, self._level) - target.residual(prediction, self._level)


def _at_once(residual: Tensor) -> int:
    """Members whose changes are made together, so that they stay in the cache or near it."""
    return max(1, NUMBERS_AT_ONCE // len(residual))


def twins(scored: Sequence[Scored]) -> list[tuple[str, ...]]:
    """For each candidate, the names of those whose signature is parallel to its own."""
    found = []
    least = SETTINGS.screening.parallel
    for one in scored:
        near = {
            other.candidate.name
            for other in scored
            if abs(float(one.signature @ other.signature)) >= least and other.candidate.name != one.candidate.name
        }
        found.append(tuple(sorted(near)))
    return found


def new_label(model: PlateModel, name: str) -> str:
    """A label that the model does not have yet."""
    number = 1
    while f"{name}_{number}" in model.effects:
        number += 1
    return f"{name}_{number}"


def _members(
    model: PlateModel, theta: Tensor, base: PlateModel, grid: Sequence[Mapping[str, float]], label: str
) -> Tensor:
    own = torch.stack([vector(model, values, label) for values in grid]).to(theta)
    return torch.where(own.isnan(), _spread(model, theta, base), own)


def _rests(
    model: PlateModel, theta: Tensor, base: PlateModel, trials: Sequence[Trial], label: str
) -> Float[Tensor, "n_member n"] | None:
    """Where tangents begin; None where steps are meant."""
    rests = [trial.rest for trial in trials]
    some = [rest for rest in rests if rest is not None]
    return _members(model, theta, base, some, label) if len(some) == len(rests) else None


def _spread(model: PlateModel, theta: Tensor, base: PlateModel) -> Tensor:
    """The baseline's values in the order of a larger model; zero for what it does not have."""
    if not len(model.names):
        return theta.new_zeros(0)
    position = {name: index for index, name in enumerate(base.names)}
    return torch.stack([theta[position[name]] if name in position else theta.new_zeros(()) for name in model.names])


def _moved(candidate: Candidate, values: dict[str, float], alpha: float) -> dict[str, float]:
    """A member's values after `alpha` times its step from the neutral ones; places stay, and sizes but of holes."""
    if candidate.is_hole:
        return as_large(values, alpha)
    for key, value in values.items():
        interval, neutral = candidate.searched[key], candidate.neutral.get(key)
        if neutral is None:
            continue
        if candidate.replaces and neutral > 0:
            # What a held edge does goes with its compliance.
            moved = 1 / (1 / neutral + alpha * (1 / value - 1 / neutral))
        elif interval.logarithmic and min(value, neutral) > 0:
            moved = neutral * (value / neutral) ** alpha
        else:
            moved = neutral + alpha * (value - neutral)
        values[key] = min(max(moved, interval.low), interval.high)
    return values


def _for_the_own(
    candidate: Candidate, values: Mapping[str, float], base: PlateModel, theta: Tensor, room: Tensor
) -> Mapping[str, float]:
    """A member's values where it stands for a number of the plate that is searched, too, within what was told of it.

    To first order both add up, and the plate's own goes back to where it was told to be; in truth one counts.
    """
    plate = next(label for label, own in base.effects.items() if own.name == "plate")
    own = f"{plate}.{candidate.name}"
    if own not in base.names or values.keys() != {"value"}:
        return values
    index, interval = base.names.index(own), candidate.searched["value"]
    value = values["value"] * float(room[index] / theta[index])
    return {"value": min(max(value, interval.low), interval.high)}


def _apart(values: Sequence[Mapping[str, float]], drop: Tensor) -> list[int]:
    """The best members, none of them near a better one."""
    chosen: list[int] = []
    for index in drop.argsort(descending=True).tolist():
        if all(distance(values[index], values[other]) >= SETTINGS.screening.apart for other in chosen):
            chosen.append(index)
        if len(chosen) == SETTINGS.screening.n_start:
            break
    return chosen


def start_of(
    model: PlateModel, theta: Tensor, base: PlateModel, values: Mapping[str, float], label: str
) -> Float[Tensor, " n"]:
    """A candidate's values beside the baseline's, as a place to start from on the unit cube."""
    own = vector(model, values, label).to(theta)
    whole = torch.where(own.isnan(), _spread(model, theta, base), own)
    return model.space.to_cube(whole).clamp(1e-3, 1 - 1e-3)
