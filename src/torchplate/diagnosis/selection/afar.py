"""Candidates where peaks need not overlap: more places to start from, and where the best end on the way down."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.localisation.localise import missing_force
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior, Problem, one_level, widely
from torchplate.diagnosis.selection.screen import Scored, start_of
from torchplate.diagnosis.selection.shortlist import acts_like
from torchplate.diagnosis.selection.trace import State
from torchplate.model import PlateModel


class FromAfar:
    """Ways down the wide levels.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
    """

    def __init__(self, builder: ModelBuilder, prior: Prior) -> None:
        self.builder, self.prior = builder, prior
        self.settings = builder.target.settings

    def begun(self, state: State, base: PlateModel, scored: Sequence[Scored]) -> list[Scored]:
        """Candidates as they were scored there, with further starts, the most promising first."""
        scored = [self.spread(state, one) for one in scored]
        return sorted(self.from_force(state, base, scored), key=lambda one: -one.drop)

    def spread(self, state: State, promise: Scored) -> Scored:
        """Starts spread over the box and the prior together, for an effect that may make another plate of it.

        These are clamps that yield, since what was fitted with a rigid one has taken on what they give; and, where the
        model is doubted or no peaks overlap, whatever of the whole plate may change by a large factor.
        """
        settings = self.settings.searching
        wide = [one for one in promise.candidate.searched.values() if one.logarithmic and one.low > 0]
        whole_plate = promise.candidate.effect.acts_on == {"section"} and not promise.candidate.has_place
        large = whole_plate and any(one.high / one.low > settings.wide_prior for one in wide)
        near = self.builder.target.trusts_the_noise and state.fit.left < self.settings.screening.overlapping
        if not promise.candidate.replaces and (near or not large):
            return promise
        whole = with_candidate(state.fit.model, promise.label, promise.candidate)
        n = len(whole.names)
        spread = SobolEngine(n).draw(2 * settings.n_spread, dtype=torch.float64).to(promise.starts)
        members = torch.cat([promise.starts, spread])
        some = torch.cat([promise.starts[:1], members[-settings.n_plates :]])
        margin = self.builder.target.settings.meshes.roughly
        problem = Problem(self.builder, self.builder.reduced(whole, whole.space.to_si(some), margin=margin), self.prior)
        value = problem.squares(members, 0)
        starts, left = widely(problem, members[value.argsort()[: settings.n_far]], settings.n_kept)
        given = Problem(self.builder, state.fit.reduced, self.prior)
        position = given.model.space.to_cube(state.fit.theta)
        before = 0.5 * float(given.residual(position, self.builder.target.levels - 2).square().sum())
        return promise._replace(model=problem.model, starts=starts, drop=max(promise.drop, 1 - float(left[0]) / before))

    def beside_itself(self, state: State, promise: Scored) -> Scored:
        """The same in modes of the plates that it starts from: those of a plate without a hole are too stiff for it."""
        whole, margin = with_candidate(state.fit.model, promise.label, promise.candidate), self.settings.meshes.roughly
        return promise._replace(model=self.builder.reduced(whole, whole.space.to_si(promise.starts), margin=margin))

    def from_force(self, state: State, base: PlateModel, scored: Sequence[Scored]) -> list[Scored]:
        """A start more for what acts at a point, where the residual force says that it is, and as large."""
        target, fit = self.builder.target, state.fit
        if not fit.by_noise:
            return list(scored)
        force = missing_force(target.measurement, target.variance.sqrt(), fit.expected, fit.reduced, fit.theta)
        found = []
        faint = self.settings.screening.faint
        for one in scored:
            (key, kind), searched = acts_like(one.candidate), one.candidate.searched
            if force is not None and kind and force.parts[kind] >= faint and force.size[kind] > 0:
                interval = searched[key]
                size = min(max(force.size[kind], interval.low), interval.high)
                values = {"x": force.place[0], "y": force.place[1], key: size}
                start = start_of(one.model, fit.theta, base, values, one.label)
                drop = max(one.drop, force.parts[kind])
                one = one._replace(starts=torch.cat([start[None], one.starts]), drop=drop)
            found.append(one)
        return found

    def down(self, state: State, promises: Sequence[Scored]) -> list[tuple[Scored, Tensor]]:
        """Candidates taken down the wide levels; those that stay near the best, with where they end."""
        given = state.fit.model
        edge = given.space.at_bound(state.fit.theta).tolist()
        stuck = [name for name, on in zip(given.names, edge, strict=True) if on]
        ways: list[tuple[float, Scored, Tensor]] = []
        for promise in promises:
            if promise.candidate.is_hole:
                promise = self.beside_itself(state, promise)
            starts = promise.starts
            if stuck:
                # On the edge of its interval it stands in for what is missing: the better starts also from the middle.
                free = starts[: (len(starts) + 1) // 2].clone()
                free[:, [promise.model.names.index(name) for name in stuck]] = 0.5
                starts = torch.cat([starts, free])
            ways.append((0.0, promise, starts))
        screening, n_best = self.settings.screening, self.settings.selecting.n_best
        for level in range(self.builder.target.levels - 1):
            ends = []
            for _, promise, starts in ways:
                starts, value = one_level(Problem(self.builder, promise.model, self.prior), starts, level, keep=n_best)
                ends.append((float(value[0]), promise, starts))
            ends.sort(key=lambda one: one[0])
            ways = [one for rank, one in enumerate(ends) if rank < n_best or one[0] <= screening.near * ends[0][0]]
        # What runs along a line comes near nearly everything, by seven numbers: it takes the place of no other.
        others = [rank for rank, (_, promise, _) in enumerate(ways) if not promise.candidate.is_line]
        n_ended = others[screening.n_sharp - 1] + 1 if len(others) >= screening.n_sharp else len(ways)
        ended = ways[:n_ended]
        simpler = {name for _, promise, _ in ended for name in promise.candidate.effect.contains}
        ended += [one for one in ways[n_ended:] if one[1].candidate.name in simpler]
        return [(promise, starts[:n_best]) for _, promise, starts in ended]
