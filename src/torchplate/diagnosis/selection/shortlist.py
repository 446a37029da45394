"""Which of the candidates that were scored are refitted, and what of that counts."""

from collections.abc import Collection, Container, Sequence

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.localisation.reach import UNIT
from torchplate.diagnosis.selection.criterion import Hypothesis
from torchplate.diagnosis.selection.screen import Scored, twins
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.settings import Screening


def acts_like(candidate: Candidate) -> tuple[str, str]:
    """The one strength of what acts at a point, and whether it is a stiffness, a damping or a mass; else empty."""
    strengths = candidate.searched.keys() - {"x", "y"}
    if candidate.has_place and len(strengths) == 1:
        (key,) = strengths
        for kind, unit in UNIT.items():
            if candidate.effect.parameters[key].unit == unit:
                return key, kind
    return "", ""


def promising(promises: Sequence[Scored], wanted: int, settings: Screening) -> list[Scored]:
    """The best names: the first option of each, a second that promises nearly as much, and what is parallel to them."""
    best: dict[str, list[Scored]] = {}
    for promise in promises:
        own = best.setdefault(promise.candidate.name, [])
        if not own or (len(own) == 1 and promise.drop >= settings.second * own[0].drop):
            own.append(promise)
    alike = dict(zip((id(promise) for promise in promises), twins(promises), strict=True))
    ranked = sorted(best, key=lambda name: -best[name][0].drop)[:wanted]
    names = [name for name in ranked if best[name][0].drop >= settings.faint * best[ranked[0]][0].drop]
    names += [other for name in names for other in alike[id(best[name][0])] if other in best]
    names = [one for name in names for one in (*contained(best[name][0].candidate, best), name)]
    return [promise for name in dict.fromkeys(names) for promise in best[name]]


def looking_like(promises: Sequence[Scored], groups: Collection[str], chosen: Sequence[Scored]) -> list[Scored]:
    """Of what looks like nuisances that would have to be larger than tests have them the first of each other name.

    Args:
        promises: the score test, the best first.
        groups: of these nuisances.
        chosen: what is refitted in any case.
    """
    names, found = {one.candidate.name for one in chosen}, []
    for one in promises:
        if one.candidate.name not in names and one.candidate.effect.like & {*groups}:
            names.add(one.candidate.name)
            found.append(one)
    return found


def contained(candidate: Candidate, names: Container[str]) -> list[str]:
    """The simpler effects of these names that a candidate becomes at an end of its parameters."""
    return [name for name in candidate.effect.contains if name in names]


def kept(
    promises: Sequence[Scored], hypotheses: Sequence[Hypothesis], state: State, settings: Screening, doubtful: float
) -> bool:
    """Whether what was refitted where peaks overlap took most of what the best promised, and leaves little.

    Beside a baseline that ended where it caught some peaks of another mode, the best may promise little.

    Args:
        promises: the score test, the best first.
        hypotheses: what was refitted.
        state: beside which.
        settings: of the screening.
        doubtful: mean square up to which little is left.
    """
    if not hypotheses:
        return False
    least = min((one.fit for one in hypotheses), key=lambda fit: fit.square)
    took = state.fit.square - least.square >= settings.kept * promises[0].drop * state.fit.square
    return took and least.reduced_misfit <= doubtful


def best_of_each(hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Of every name the best."""
    best: dict[str, Hypothesis] = {}
    for one in hypotheses:
        if one.name not in best or one.cost < best[one.name].cost:
            best[one.name] = one
    return list(best.values())
