"""Effects fitted to the natural frequencies that were measured, and from there to the FRFs."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.candidates.images import images
from torchplate.diagnosis.fit import Beat
from torchplate.diagnosis.judged import settled
from torchplate.diagnosis.model_builder import ModelBuilder, with_candidate
from torchplate.diagnosis.problem import Prior, Problem
from torchplate.diagnosis.selection.criterion import Hypothesis, is_noise
from torchplate.diagnosis.selection.refit import Refits
from torchplate.diagnosis.selection.screen import new_label, start_of
from torchplate.diagnosis.selection.starts import nearest
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.table import Asked, Told
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel


class Both(NamedTuple):
    """Two effects, fitted to FRFs from where natural frequencies have them.

    Attributes:
        first: of them, as it is beside the other, which lacks.
        second: beside the first.
    """

    first: Hypothesis
    second: Hypothesis


class ByFrequencies:
    """Refits of what the natural frequencies say is missing.

    Sharp peaks that do not overlap do not attract each other, and smoothed FRFs say little of what is small, as a
    notch. A frequency is drawn to the measured one however far off it is: which is how tests are updated by hand.
    Where a plate is symmetric they do not tell a place from its mirror images; the FRFs do.

    Args:
        builder: builds and evaluates the models.
        prior: what is known of the given model's parameters beforehand.
        refits: of candidates.
    """

    def __init__(self, builder: ModelBuilder, prior: Prior, refits: Refits) -> None:
        self.builder, self.prior, self.refits = builder, prior, refits
        self.settings = builder.target.settings
        self._last: Asked | None = None

    def of(
        self, state: State, found: Sequence[Hypothesis], everyone: Sequence[Candidate], limit: float, beat: Beat
    ) -> list[Hypothesis]:
        """Those that leave at most a tenth of what the frequencies have without them, the nearest first.

        They are not asked where something is named already, where little is left, or something that was fitted leaves
        little.

        Args:
            state: without them.
            found: what was fitted to the FRFs.
            everyone: the candidates.
            limit: sum of squares beyond which a fit is not followed to its end.
            beat: what it has to come near for that.
        """
        if (asked := self.asked(state, found)) is None:
            return []
        every = [one for one in asked.singles if one.left <= self.settings.selecting.much_less]
        ended: list[Hypothesis] = []
        for one in every[: self.settings.selecting.n_best]:
            if not (chosen := _chosen(one, everyone)):
                continue
            (candidate,), (own,) = chosen, one.own
            label = new_label(state.model, candidate.name)
            whole = with_candidate(state.model, label, candidate)
            start = start_of(whole, self._others(state, one), state.model, own, label)
            for place in self._images(state, whole, start, label)[: self.settings.selecting.n_best]:
                starts = nearest(self.builder, self.prior, whole, place[None], state.fit.about, down=True)
                ended.append(self.refits.refit(state, candidate, label, starts, limit, state.fit.about, beat=beat))
                if is_noise(ended[-1].fit):
                    return ended
        return ended

    def both(self, state: State, found: Sequence[Hypothesis], everyone: Sequence[Candidate]) -> Both | None:
        """Two effects that frequencies have together, if of these and of FRFs they leave far less than any alone.

        Args:
            state: without them.
            found: what was fitted to the FRFs.
            everyone: the candidates.
        """
        if (asked := self.asked(state, found)) is None or not asked.singles:
            return None
        settings = self.settings.selecting
        alone = min(one.evidence for one in asked.singles)
        pairs = [one for one in asked.pairs if one.left <= settings.much_less and one.evidence < alone]
        most = settings.explains_much * min(fit.square for fit in (state.fit, *(one.fit for one in found)))
        ended: list[Both] = []
        for one in pairs[: settings.n_best]:
            if chosen := _chosen(one, everyone):
                ended.append(self._both(state, one, chosen))
                if is_noise(ended[-1].second.fit):
                    break
        best = min(ended, key=lambda both: both.second.fit.square, default=None)
        return best if best is not None and best.second.fit.square <= most else None

    def _both(self, state: State, one: Told, chosen: Sequence[Candidate]) -> Both:
        """Two effects from where frequencies have them, or from those of their images that FRFs are nearest to."""
        (first, second), (own, further) = chosen, one.own
        label = new_label(state.model, first.name)
        model = with_candidate(state.model, label, first)
        theta = model.space.to_si(start_of(model, self._others(state, one), state.model, own, label))
        beside = new_label(model, second.name)
        whole = with_candidate(model, beside, second)
        start = start_of(whole, theta, model, further, beside)
        place = self._images(state, whole, start, label, beside)[0]
        alone = State(model, state.fit._replace(model=model, theta=theta))
        starts = nearest(self.builder, self.prior, whole, place[None], state.fit.about, down=True)
        ended = self.refits.refit(alone, second, beside, starts, about=state.fit.about)
        return Both(self._as_it_is(state, first, label, model, ended), ended)

    def _as_it_is(self, state: State, first: Candidate, label: str, model: PlateModel, ended: Hypothesis) -> Hypothesis:
        """The first of two where both have ended, judged without the second."""
        theta, about = ended.beside(model), state.fit.about
        corrected = self.builder.corrected(model, theta).model
        plain = self.builder.reduced(corrected, theta[None], about=about)
        position = model.space.to_cube(theta).clamp(0.0, 1.0)
        fit = settled(self.builder, corrected, plain, self.prior, position, about, fitted_on=False)
        return Hypothesis(first, label, fit, n_option=self.refits.n_option.get(first.cause, 1))

    def asked(self, state: State, found: Sequence[Hypothesis]) -> Asked | None:
        """The frequencies, where nothing is named and what was fitted leaves far more than noise; None elsewhere.

        A baseline that ended elsewhere has the same ones again.

        Args:
            state: with nothing named, or something.
            found: what was fitted to the FRFs.
        """
        doubtful, fits = self.settings.selecting.doubtful, [state.fit, *(one.fit for one in found)]
        if state.named or not state.fit.by_noise or min(one.reduced_misfit for one in fits) <= doubtful:
            return None
        if (table := self.table(state)) is None:
            return None
        last = self._last
        if last is None or last.model is not state.model or not torch.equal(last.table.mode, table.mode):
            last = self._last = Asked(state.model, table, self.prior)
        return last

    def _others(self, state: State, one: Told) -> Float[Tensor, " n"]:
        """The model's own numbers, those that frequencies can see as they have them."""
        values = state.model.as_dict(state.fit.theta) | one.others
        return state.fit.theta.new_tensor([values[name] for name in state.model.names])

    def _images(
        self, state: State, whole: PlateModel, start: Float[Tensor, " n"], *labels: str
    ) -> list[Float[Tensor, " n"]]:
        """A place and its mirror images, those first that FRFs are nearest to."""
        every = torch.cat([start[None], images(whole, start, *labels)])
        return sorted(every, key=lambda place: self._left(state, whole, place))

    def _left(self, state: State, whole: PlateModel, place: Float[Tensor, " n"]) -> float:
        """What a member leaves of FRFs that are smoothed a little, in the modes of its own plate."""
        theta, about = whole.space.to_si(place), state.fit.about
        reduced = self.builder.reduced(whole, theta[None], about=about)
        problem = Problem(self.builder, self.builder.target.specimen(reduced, theta, about), self.prior)
        return float(problem.squares(place[None], self.builder.target.levels - 2))

    def table(self, state: State) -> NaturalFrequencies | None:
        """The natural frequencies of the measurement, by the numbers of the model's modes; None where too few are.

        Args:
            state: of which the modes are.
        """
        resonances = self.builder.target.noise.resonances
        if resonances is None:
            return None
        measured = sharp(resonances.pole[resonances.resonates])
        modes = state.fit.reduced.modes(state.fit.theta[None]).frequency[0]
        # Of a free plate that hangs on nothing the rigid-body modes are at zero, and no test has them.
        first = int((modes <= 0).sum())
        screening, (low, high) = self.settings.screening, resonances.band
        here, number = paired(measured, modes[first:], screening.moved, screening.missed)
        # A pole beyond the lines is there, but not well known.
        inside = (measured[here] >= low) & (measured[here] <= high)
        # With no more frequencies than numbers that they are to tell, any effect explains them.
        if int(inside.sum()) <= len(state.model.names):
            return None
        return NaturalFrequencies(number[inside] + first + 1, measured[here[inside]])


def _chosen(told: Told, everyone: Sequence[Candidate]) -> list[Candidate]:
    """The candidates of effects that frequencies were fitted with; none, where one of them has other numbers."""
    every = {(one.name, str(one.options)): one for one in everyone}
    found = [every.get((name, str(options))) for name, options in zip(told.names, told.options, strict=True)]
    pairs = zip(found, told.own, strict=True)
    if not all(one is not None and own.keys() <= one.searched.keys() for one, own in pairs):
        return []
    return [one for one in found if one is not None]


def sharp(pole: Complex[Tensor, " n_pole"]) -> Float[Tensor, " n"]:
    """The natural frequencies of poles, rising, but for those that a fit has made for what is smooth [Hz].

    These are so broad that another of less than half their width lies within it.

    Args:
        pole: q = f² (1 + iη) [Hz²].
    """
    pole = pole[pole.real > 0]
    frequency = pole.real.sqrt()
    width = frequency * pole.imag / pole.real
    away = (frequency[:, None] - frequency).abs()
    broad = ((away < width[:, None]) & (2 * width < width[:, None])).any(-1)
    return frequency[~broad].sort().values


def paired(
    measured: Float[Tensor, " n"], modes: Float[Tensor, " n_mode"], moved: float, missed: float
) -> tuple[Int[Tensor, " k"], Int[Tensor, " k"]]:
    """Which measured frequencies are which modes, most probably, both in their order.

    Frequencies are off by a normal deviate each, on a logarithmic scale; a test misses some of the modes, as those that
    have a node at each sensor, and has as many frequencies that are none.

    Args:
        measured: rising [Hz].
        modes: of the model, rising [Hz].
        moved: standard deviation of what a mode is off [-].
        missed: part of the modes that a test misses [-].

    Returns:
        Measured frequencies and modes that belong together, both from 0.
    """
    n, m, lost = len(measured), len(modes), -2 * math.log(missed)
    own = ((modes.log()[None] - measured.log()[:, None]) / moved).square().tolist()
    # Of the first k measured and the first j modes: the least sum, and by which step: a pair, a frequency, a mode.
    total = [[lost * (k + j) for j in range(m + 1)] for k in range(n + 1)]
    step = [[(0, 1) if j else (1, 0) for j in range(m + 1)] for _ in range(n + 1)]
    for k in range(1, n + 1):
        for j in range(1, m + 1):
            ways = {
                (1, 1): total[k - 1][j - 1] + own[k - 1][j - 1],
                (1, 0): total[k - 1][j] + lost,
                (0, 1): total[k][j - 1] + lost,
            }
            step[k][j] = min(ways, key=lambda one: ways[one])
            total[k][j] = ways[step[k][j]]
    # Modes beyond the last that was measured nobody looked for.
    k, j = n, min(range(m + 1), key=lambda j: total[n][j])
    pairs = []
    while k or j:
        back = step[k][j] if k and j else (int(k > 0), int(k == 0))
        k, j = k - back[0], j - back[1]
        if back == (1, 1):
            pairs.append((k, j))
    both = torch.tensor(pairs[::-1], dtype=torch.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]
