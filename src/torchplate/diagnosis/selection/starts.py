"""Where refits begin: beside which plate, and of all sizes and strengths at a place those that fit best."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidates.trials import spread_at
from torchplate.diagnosis.judged import beside, judged_beside
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior, Problem, widely
from torchplate.diagnosis.selection.criterion import excessive, known_section
from torchplate.diagnosis.selection.screen import Scored, start_of
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.settings import SETTINGS
from torchplate.discrepancy import Found
from torchplate.model import PlateModel


def spread_out(
    builder: ModelBuilder, prior: Prior, state: State, base: PlateModel, promise: Scored
) -> Float[Tensor, "n_start n"]:
    """Members at the places that promise most, the nearest beside noise and nuisances first.

    How large it is there a step that is linear does not say.

    Args:
        builder: evaluates them.
        prior: what is known of the given model's parameters beforehand.
        state: without it.
        base: the same in a basis.
        promise: of the score test where peaks overlap.
    """
    candidate, theta = promise.candidate, state.fit.theta
    whole = with_candidate(base, promise.label, candidate)
    members = [promise.starts]
    for start in promise.starts[: builder.target.settings.selecting.n_best]:
        values = whole.as_dict(whole.space.to_si(start))
        place = values[f"{promise.label}.x"], values[f"{promise.label}.y"]
        some = spread_at(candidate, *place, builder.target.settings.searching.n_spread)
        members.append(torch.stack([start_of(whole, theta, base, own, promise.label) for own in some]))
    every, level = torch.cat(members), builder.target.levels - 1
    left = Problem(builder, whole, prior, state.fit.marginal).squares(every, level)
    # Half of them as they were promised, at other places; and the last of those, which is where the model is: with an
    # effect more it cannot end farther off than without.
    half = builder.target.settings.screening.n_start // 2
    return torch.cat([every[left.argsort()[:half]], promise.starts[:-1][:half], promise.starts[-1:]])


def beside_what_was_told(builder: ModelBuilder, prior: Prior, state: State) -> State:
    """The state that candidates are scored beside: the plate as it was told, where smoothed FRFs take it.

    A specimen that wanders by more than plates do has taken on what is missing. Candidates are not fitted beside it,
    and beside it they would promise what it has left. Where only dampings are off their law by more than those of
    plates are, they are put back, and the section stays as it was found.

    Args:
        builder: evaluates them.
        prior: what is known of the given model's parameters beforehand.
        state: as it was fitted; it is returned as it is where its specimen is as plates are.
    """
    before, model, target = state.fit, state.fit.model, builder.target
    if before.about is None or not model.names or not excessive(before):
        return state
    position = model.space.to_cube(before.theta)
    if (about := known_section(before)) is not None:
        plain = builder.reduced(model, before.theta[None], about=about)
        reduced = target.specimen(plain, before.theta, about)
        of_fit = beside(target, reduced, before.theta, about)
        return replace(state, fit=judged_beside(builder, model, reduced, prior, position, of_fit))
    plain = builder.reduced(model, before.theta[None])
    told = before.theta.clone()
    for index, name in enumerate(model.names):
        told[index] = prior[name][0] if name in prior else told[index]
    starts = torch.stack([position, model.space.to_cube(told)]).clamp(0.0, 1.0)
    end = widely(Problem(builder, plain, prior), starts)[0][0]
    of_fit = beside(target, plain, model.space.to_si(end), None)
    return replace(state, fit=judged_beside(builder, model, plain, prior, end, of_fit))


def without_rigid(
    model: PlateModel, promise: Scored, starts: Float[Tensor, "n_start n"]
) -> tuple[Scored, Float[Tensor, "n_start _"]]:
    """A held edge that may yield, without those of its springs that are rigid wherever it begins.

    Whatever such a spring is, the FRFs stay as they are: its column of the Jacobian is rounding, by which a fit would
    take it to an end of its interval that the basis does not know. Once the edge was found, and noise is all that is
    left beside it, it is tried with all.

    Args:
        model: without it.
        promise: of the edge, or of anything else, which stays as it is.
        starts: on the unit cube of the model with it.
    """
    candidate, softer = promise.candidate, SETTINGS.trials.softer
    whole = with_candidate(model, promise.label, candidate)
    theta = dict(zip(whole.names, whole.space.to_si(starts).unbind(-1), strict=True))
    rigid = {
        key
        for key, held in candidate.neutral.items()
        if candidate.replaces and held > 0 and bool((theta[f"{promise.label}.{key}"] > softer * held).all())
    }
    if not rigid or len(rigid) == len(candidate.searched):
        return promise, starts
    free = [name not in {f"{promise.label}.{key}" for key in rigid} for name in whole.names]
    return promise._replace(candidate=candidate.without(rigid)), starts[:, free]


def nearest(
    builder: ModelBuilder,
    prior: Prior,
    model: PlateModel,
    members: Float[Tensor, "n_member n"],
    about: Found | None,
    down: bool = False,
) -> Float[Tensor, "n_start n"]:
    """Of many members those that are nearest where spectra are smoothed a little.

    Args:
        builder: evaluates them.
        prior: what is known of the given model's parameters beforehand.
        model: of which these are members, in all dofs.
        members: on the unit cube.
        about: the specimen that they stand for.
        down: whether ends of ways down the wide levels come before them.
    """
    target, theta = builder.target, model.space.to_si(members[:1])
    reduced = target.specimen(builder.reduced(model, theta, about=about), theta[0], about)
    problem, settings = Problem(builder, reduced, prior), target.settings
    near = members[problem.squares(members, target.levels - 2).argsort()[: settings.screening.n_start]]
    return torch.cat([widely(problem, near, settings.selecting.n_best)[0], near]) if down else near
