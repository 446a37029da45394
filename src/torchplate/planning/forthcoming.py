"""The data that a proposed test would give, as each hypothesis predicts them, over noise and nuisances.

The noise is as it was found in the measured test: of each FRF half in proportion to it and half the same at all lines.
What the test is not perfect in comes in through the covariance of `discrepancy.marginal`, taken at the most probable
hypothesis: hits and sensors off their marks, calibration, drift from record to record, and what the mesh leaves. Beside
these each hypothesis has columns of its own, by one standard deviation each: its parameters along the principal axes of
their posterior, its specimen as far as it was found, the weight and place of what is attached, and a drift of all
natural frequencies between the two tests. A column of parameters is a secant over one standard deviation to either
side; half the bend of the FRFs between them is one more, so that what is not linear is not believed.

Source: Julier and Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92 (2004) 401, for secants.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis import Doubt, FrfTarget
from torchplate.discrepancy import Marginal
from torchplate.measurement import Channel, Measurement, Noise
from torchplate.planning.bench import Bench
from torchplate.planning.proposal import Proposal

# A standard deviation that has less room than this part of itself inside the box goes to the other side alone [-].
ROOM = 1e-3


class Predicted(NamedTuple):
    """What one hypothesis says of a test, over noise and nuisances.

    Attributes:
        mean: less what the most probable one says.
        columns: by one standard deviation each: of the parameters along their principal axes, of half their bends along
            these, and of all else.
        n_parameter: how many parameters there are.
    """

    mean: Float[Tensor, " n_number"]
    columns: Float[Tensor, "n_number n_column"]
    n_parameter: int


class Forthcoming:
    """A test that has not been made.

    Args:
        benches: the hypotheses, the most probable first.
        target: the measured test, what its mesh leaves included.
        doubt: what is known of it beside these.
        proposal: the test; the measured one again, where it is left out.
    """

    @torch.no_grad()
    def __init__(
        self, benches: Sequence[Bench], target: FrfTarget, doubt: Doubt, proposal: Proposal | None = None
    ) -> None:
        self.benches, self.proposal = benches, proposal
        self._predicted: dict[int, Predicted] = {}
        self.states = [bench.state(proposal) for bench in benches]
        first, state = benches[0], self.states[0]
        theta = first.in_state(state, first.here)
        same = proposal is None or (proposal.response is None and proposal.reference is None)
        measured = target.measurement.measured if same else None
        self.expected = state.frf(theta, target.frequency)
        self.target = _held_against(target, self.expected, doubt, measured)
        n = 2 * len(target.frequency)
        before, after = n * int(target.fitted.sum()), n * int(self.target.fitted.sum())
        # What each number is worth beside so many others is as it was.
        self.weight = doubt.weight * min(1.0, before / after)
        self.marginal: Marginal = self.target.marginal(state, theta, specimen=False)

    def white(self, off: Complex[Tensor, "*batch n_frequency n_response n_reference"]) -> Tensor:
        """Deviations over noise and nuisances, as independent numbers."""
        return self.weight**0.5 * self.marginal.whitened(self.marginal.over_noise(off))

    def says(self, index: int, position: Float[Tensor, "*batch n"]) -> Tensor:
        """FRFs of one hypothesis."""
        state = self.states[index]
        return self.target.predict(state, self.benches[index].in_state(state, position))

    @torch.no_grad()
    def predicted(self, index: int) -> Predicted:
        """What one hypothesis says, and what it leaves open."""
        if index not in self._predicted:
            middle = self.says(index, self.benches[index].here)
            slopes, bends = self._secants(index, middle)
            changes = torch.cat([slopes, bends, self.specimen(index), self.common])
            columns = self.white(changes).mT
            self._predicted[index] = Predicted(self.white(middle - self.expected), columns, len(slopes))
        return self._predicted[index]

    def specimen(self, index: int) -> Complex[Tensor, "n_column n_frequency n_response n_reference"]:
        """What one hypothesis leaves open of the specimen, by one standard deviation each."""
        bench, state = self.benches[index], self.states[index]
        theta = bench.in_state(state, bench.here)
        columns = bench.specimen_columns(state, theta, self.target.frequency, self.expected)
        return columns * self.target.gain_of(state, theta) if self.target.gain_is_unknown else columns

    @functools.cached_property
    def common(self) -> Complex[Tensor, "n_column n_frequency n_response n_reference"]:
        """What the state itself leaves open, the same for all hypotheses: by one standard deviation each."""
        bench, state = self.benches[0], self.states[0]
        frequency, theta = self.target.frequency, bench.in_state(state, bench.here)
        found = []
        for off in () if self.proposal is None else self.proposal.off:
            moved = bench.state(off)
            found.append(moved.frf(bench.in_state(moved, bench.here), frequency))
        drift = self.target.imperfections.std("frequency_drift")
        if drift > 0 and self.target.trusts_the_noise:
            # All natural frequencies higher by a part are the lines lower by it.
            found.append(state.frf(theta, (1 - drift) * frequency))
        return torch.stack(found) - self.expected if found else self.expected[None][:0]

    def _secants(self, index: int, middle: Tensor) -> tuple[Tensor, Tensor]:
        """Slopes and half the bends along the principal axes, by one standard deviation each."""
        bench = self.benches[index]
        here, axes = bench.here, bench.axes
        if not len(here):
            return middle[None][:0], middle[None][:0]
        up, down = (_room(here, sign * axes) for sign in (1.0, -1.0))
        both = torch.minimum(up, down) > ROOM
        least = torch.minimum(up, down)
        up = torch.where(both, least, torch.where(up >= down, up, 0.0))
        down = torch.where(both, least, torch.where(up > 0, 0.0, down))
        ends = torch.cat([here + up[:, None] * axes.mT, here - down[:, None] * axes.mT]).clamp(0.0, 1.0)
        above, below = self.says(index, ends).chunk(2)
        over = (-1, *(1,) * middle.ndim)
        slopes = (above - below) / (up + down).clamp(min=ROOM).reshape(over)
        bends = (above + below - 2 * middle) / (2 * 2**0.5 * up.square().clamp(min=ROOM**2).reshape(over))
        return slopes, torch.where(both.reshape(over), bends, 0.0)


def _room(here: Float[Tensor, " n"], axes: Float[Tensor, "n n"]) -> Float[Tensor, " n"]:
    """How far each axis goes within the unit cube, in lengths of it, and at most once."""
    end = torch.where(axes > 0, 1 - here[:, None], here[:, None])
    return (end / axes.abs().clamp(min=1e-300)).amin(0).clamp(max=1.0)


def _held_against(target: FrfTarget, expected: Tensor, doubt: Doubt, measured: Tensor | None) -> FrfTarget:
    """What a test that has not been made would be held against: its FRFs as they are expected, and their noise.

    Args:
        target: the measured test.
        expected: FRFs.
        doubt: what was found of the noise.
        measured: which FRFs are read; left out, all.
    """
    before, frequency = target.measurement, target.frequency
    n_response, n_reference = expected.shape[1:]
    kept = torch.ones(n_response, n_reference, dtype=torch.bool) if measured is None else measured
    share = target.noise.std.square().sum(0) / before.frf.abs().square().sum(0).clamp(min=1e-300)
    power = expected.abs().square()
    level = doubt.noise_scale**2 * share[before.measured].median()
    std = (level * 0.5 * (power + power.mean(0))).sqrt()
    frfs = Measurement(
        frequency,
        expected,
        kept,
        tuple(Channel(k + 1) for k in range(n_response)),
        tuple(Channel(k + 1) for k in range(n_reference)),
        before.kind,
        before.unit,
    )
    noise = Noise(std, target.noise.floor, (), torch.zeros_like(std))
    plain = dataclasses.replace(
        target, measurement=frfs, noise=noise, heldout=~kept, sign=None, model_variance=None, mesh_shift=None
    )
    if target.mesh_shift is None:
        return plain
    place, shape = target.mesh_left
    found = plain.with_mesh_error(target.mesh_shift, shape / target.settings.meshes.shape[1], target.n_mode, place)
    if doubt.by_noise:
        return found
    # What the model as such leaves of the measured test, it leaves of the next one.
    left = 0.5 * doubt.gap**2 * found.smoothing.around
    independent = min(1.0, found.n_modal / (2 * len(frequency) * int(kept.sum())))
    assert found.model_variance is not None
    return dataclasses.replace(
        found, trusts_the_noise=False, model_variance=found.model_variance + left, independent=independent
    )
