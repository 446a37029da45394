"""Where a model and a measurement disagree: in frequency, over the channels, over the plate, and of which kind.

Whatever stiffness, mass or dashpot is missing at one place g, the FRFs change by

    H_jk − H⁰_jk = −α_jg y α_gk,    y(ω) = z / (1 + z α_gg),    z(ω) = k + iωc − ω²m,

exactly, however large z is (Sherman and Morrison); α are the model's own receptances, which reach places where no
sensor is. So for each place and line the best complex y follows from all channels by least squares, weighed by the
noise, and the place that explains most is where a force is missing: a residual force vector without an expansion
(Link, "Localization of errors in computational models using dynamic test data", EURODYN, 1990; Friswell and
Mottershead, Finite Element Model Updating in Structural Dynamics, 1995, ch. 5). What z does with frequency tells
stiffness, damping and mass apart. A sensor chain that is wrong multiplies instead: one gain and delay for all channels,
or a factor for one of them.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float
from torch import Tensor

from torchplate.diagnosis.result import Band, ChannelGap, ForceMap, Location
from torchplate.effects import ChannelSwap, SensorChain
from torchplate.measurement import Measurement
from torchplate.model import PlateModel
from torchplate.model.frf import DERIVATIVE, laplace_lines, sensor_chain

# Places along each side of the map.
N_PLACE: Final = 13
# Below this many FRFs, one free number for each line explains too much to say where.
LEAST_FRF: Final = 3
# Bands that are named, the part of the misfit that they are to hold, lines of the moving mean, and between two bands.
N_BAND, IN_BANDS, N_MEAN, APART = 5, 0.8, 3, 3
# A misfit this much above what noise makes is a misfit.
BEYOND_NOISE: Final = 1.25
# Peaks of the map at which the kind is looked at, and how far below the highest they may be.
N_PEAK, BELOW = 5, 0.15
# Steps around the best of them, relative.
POLISH: Final = (0.025, 0.012)
# A force, and a factor, that explain this part of the misfit are named; two nearer than NEAR are not told apart.
NAMED, NAMED_FACTOR, NEAR = 0.5, 0.7, 0.03
# A force that explains less than this part is said to leave something.
NEARLY_ALL: Final = 0.85
# Delays that are tried [s], and turns of the fit of z.
LONGEST_DELAY, N_DELAY, N_TURN = 0.01, 1001, 12
KINDS: Final = {"stiffness": 0, "damping": 1, "mass": 2}
UNIT: Final = {"stiffness": "N/m", "damping": "N s/m", "mass": "kg"}
WORDS: Final = {
    "stiffness": "does not depend on frequency (spring-like",
    "damping": "grows with frequency, against the velocity (dashpot-like",
    "mass": "grows with the square of frequency (mass-like",
}


@torch.no_grad()
def localise(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    predicted: Complex[Tensor, "n_frequency n_response n_reference"],
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    heldout: Bool[Tensor, "n_response n_reference"],
    after: Complex[Tensor, "n_frequency n_response n_reference"] | None = None,
) -> Location:
    """Tell where the misfit sits.

    Args:
        measurement: what was measured.
        noise_std: standard deviation of the real and of the imaginary part, in its unit.
        predicted: the fitted baseline's FRFs.
        model: it; its own responses and references are those of the measurement.
        theta: its parameters [SI].
        heldout: FRFs that no fit saw.
        after: the last model's FRFs, for the gaps of the channels; left out, the baseline's.
    """
    misfit = _Misfit.of(measurement, noise_std, predicted)
    channels = channel_gaps(measurement, noise_std, predicted, predicted if after is None else after, heldout)
    if misfit.excess <= (BEYOND_NOISE - 1) * misfit.noise:
        return Location(
            (), channels, {}, None, ("What the model leaves is what the noise makes: no place stands out.",)
        )
    bands = misfit.bands(measurement.frequency)
    chain = _common_factor(misfit, measurement.frequency)
    one = _own_factor(misfit, measurement)
    kind = {"sensor chain": chain.part, "single channel": one.part}
    sentences = [_of_bands(bands), _of_channels(channels)]
    field, force = None, None
    field_force = _force(misfit, measurement, model, theta)
    if field_force is not None:
        field, force = field_force
        kind = {"force": force.free, **force.parts, **kind}
    sentences += _of_kind(force, chain, one)
    return Location(bands, channels, kind, field, tuple(sentence for sentence in sentences if sentence))


@torch.no_grad()
def missing_force(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    predicted: Complex[Tensor, "n_frequency n_response n_reference"],
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
) -> "Force | None":
    """The force at one place that explains most of the misfit; None where there is none, or too few FRFs to say.

    Args:
        measurement: what was measured.
        noise_std: standard deviation of the real and of the imaginary part, in its unit.
        predicted: the model's FRFs.
        model: it; its own responses and references are those of the measurement.
        theta: its parameters [SI].
    """
    misfit = _Misfit.of(measurement, noise_std, predicted)
    if misfit.excess <= (BEYOND_NOISE - 1) * misfit.noise:
        return None
    found = _force(misfit, measurement, model, theta)
    return None if found is None else found[1]


def channel_gaps(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    before: Complex[Tensor, "n_frequency n_response n_reference"],
    after: Complex[Tensor, "n_frequency n_response n_reference"],
    heldout: Bool[Tensor, "n_response n_reference"],
) -> tuple[ChannelGap, ...]:
    """‖measured − model‖ / ‖measured‖ of every FRF, and what noise alone makes of it, the worst first."""
    norm = measurement.frf.norm(dim=0)
    safe = torch.where(norm > 0, norm, 1.0)
    gaps = [(measurement.frf - model).norm(dim=0) / safe for model in (before, after)]
    floor = math.sqrt(2) * noise_std.norm(dim=0) / safe
    found = [
        ChannelGap(
            measurement.response[j].label,
            measurement.reference[k].label,
            float(gaps[0][j, k]),
            float(gaps[1][j, k]),
            float(floor[j, k]),
            bool(heldout[j, k]),
        )
        for j, k in measurement.pairs
    ]
    return tuple(sorted(found, key=lambda one: -one.before))


class _Misfit(NamedTuple):
    """What is left, in standard deviations of its noise.

    Attributes:
        measured: over the noise; 0 where not measured.
        predicted: likewise.
        residual: their difference.
        inverse: one over the noise.
        total: Σ|residual|².
        noise: what noise alone would make of it: 2 for each line of each FRF.
    """

    measured: Complex[Tensor, "n_frequency n_response n_reference"]
    predicted: Complex[Tensor, "n_frequency n_response n_reference"]
    residual: Complex[Tensor, "n_frequency n_response n_reference"]
    inverse: Float[Tensor, "n_frequency n_response n_reference"]
    total: float
    noise: float

    @classmethod
    def of(cls, measurement: Measurement, std: Tensor, predicted: Tensor) -> "_Misfit":
        """A line without noise weighs as much as one with a millionth of its FRF's root mean square."""
        least = 1e-6 * measurement.frf.abs().square().mean(0).sqrt()
        std = torch.maximum(std, least.expand_as(std))
        kept = measurement.measured & (std > 0)
        inverse = torch.where(kept, 1 / torch.where(kept, std, 1.0), 0.0)
        residual = (measurement.frf - predicted) * inverse
        total = float(residual.abs().square().sum())
        return cls(measurement.frf * inverse, predicted * inverse, residual, inverse, total, 2.0 * float(kept.sum()))

    @property
    def excess(self) -> float:
        """The misfit beyond noise."""
        return self.total - self.noise

    @property
    def n_frf(self) -> int:
        """Measured FRFs."""
        return int((self.inverse > 0).any(0).sum())

    def part(self, left: float) -> float:
        """Part of the excess that is gone where so much of the misfit is left."""
        return min(1.0, max(0.0, 1 - (left - self.noise) / self.excess))

    def bands(self, frequency: Float[Tensor, " n_frequency"]) -> tuple[Band, ...]:
        """The fewest lines that hold most of the misfit, neighbours joined, the worst first."""
        line = (self.residual.abs().square() - 2 * (self.inverse > 0)).sum((-2, -1)).clamp(min=0.0)
        window = line.new_ones(1, 1, N_MEAN) / N_MEAN
        smooth = torch.nn.functional.conv1d(line[None, None], window, padding=N_MEAN // 2)[0, 0]
        order = smooth.argsort(descending=True)
        needed = int((smooth[order].cumsum(0) < IN_BANDS * smooth.sum()).sum()) + 1
        chosen = order[:needed].sort().values.tolist()
        runs = [[chosen[0], chosen[0]]]
        for index in chosen[1:]:
            if index - runs[-1][1] > APART:
                runs.append([index, index])
            runs[-1][1] = index
        total = float(line.sum())
        found = [
            Band(float(frequency[low]), float(frequency[high]), float(line[low : high + 1].sum()) / total)
            for low, high in runs
        ]
        return tuple(sorted(found, key=lambda band: -band.share)[:N_BAND])


class _Factor(NamedTuple):
    """A factor on channels.

    Attributes:
        part: of the misfit that it explains.
        gain: real.
        delay: [s].
        channel: which; empty for all.
        alone: what the gain alone and the delay alone explain.
    """

    part: float
    gain: float
    delay: float = 0.0
    channel: str = ""
    alone: tuple[float, float] = (0.0, 0.0)


def _common_factor(misfit: _Misfit, frequency: Float[Tensor, " n_frequency"]) -> _Factor:
    """The gain and delay, measured = gain exp(−iωτ) predicted, that explain most, over all channels."""
    omega = 2 * torch.pi * frequency
    cross = (misfit.predicted.conj() * misfit.measured).sum((-2, -1))
    power = max(float(misfit.predicted.abs().square().sum()), 1e-300)
    whole = float(misfit.measured.abs().square().sum())

    def matched(delay: Tensor) -> Tensor:
        """Σ Re(cross exp(iωτ)), by τ."""
        angle = omega * delay[:, None]
        return angle.cos() @ cross.real - angle.sin() @ cross.imag

    delay, span = omega.new_zeros(()), LONGEST_DELAY
    for _ in range(5):
        tried = delay + torch.linspace(-span, span, N_DELAY, dtype=omega.dtype, device=omega.device)
        # A sign of all channels is a gain of −1.
        delay = tried[matched(tried).abs().argmax()]
        span *= 4 / N_DELAY
    at = float(matched(delay[None]))
    still = float(cross.real.sum())
    gain_alone = misfit.part(whole - still**2 / power)
    delay_alone = misfit.part(whole - 2 * at + power)
    part = misfit.part(whole - at**2 / power)
    if gain_alone >= part - NEAR:
        return _Factor(gain_alone, still / power, alone=(gain_alone, delay_alone))
    return _Factor(part, at / power, float(delay), alone=(gain_alone, delay_alone))


def _own_factor(misfit: _Misfit, measurement: Measurement) -> _Factor:
    """The real factor on one FRF, one response or one reference that explains most; on none where all are one."""
    cross = (misfit.predicted.conj() * misfit.measured).real.sum(0)
    power = misfit.predicted.abs().square().sum(0)
    before = misfit.residual.abs().square().sum(0)
    whole = misfit.measured.abs().square().sum(0)
    sides = [
        (lambda value: value.flatten(), [measurement.pair_label(j, k) for j, k in _all_pairs(measurement)]),
        (lambda value: value.sum(1), [f"all of response {one.label}" for one in measurement.response]),
        (lambda value: value.sum(0), [f"all of reference {one.label}" for one in measurement.reference]),
    ]
    best = _Factor(0.0, 1.0)
    for gather, labels in sides:
        if len(labels) < 2:
            continue
        own_cross, own_power = gather(cross), gather(power).clamp(min=1e-300)
        fall = gather(before) - (gather(whole) - own_cross.square() / own_power)
        index = int(fall.argmax())
        part = misfit.part(misfit.total - float(fall[index]))
        # A single FRF comes first: a row of one FRF is that FRF.
        if part > best.part + 1e-9:
            best = _Factor(part, float(own_cross[index] / own_power[index]), channel=labels[index])
    return best


def _all_pairs(measurement: Measurement) -> list[tuple[int, int]]:
    return [(j, k) for j in range(len(measurement.response)) for k in range(len(measurement.reference))]


class Force(NamedTuple):
    """A force at one place that would explain the misfit.

    Attributes:
        place: relative.
        others: places that explain as much.
        free: part of the misfit explained if it is free at every line.
        parts: explained by a spring, a dashpot, a mass alone, and by all three together ("place").
        size: of each alone, in SI units.
    """

    place: tuple[float, float]
    others: tuple[tuple[float, float], ...]
    free: float
    parts: dict[str, float]
    size: dict[str, float]


class _Reach:
    """From forces at places to all channels, in standard deviations of the noise."""

    def __init__(self, misfit: _Misfit, measurement: Measurement, model: PlateModel, theta: Tensor) -> None:
        self.misfit, self.model, self.theta = misfit, model, theta
        self.frequency = measurement.frequency.to(theta)
        assert model.response is not None
        assert model.reference is not None
        self.response = model.mesh.places(model.response).to(theta)
        self.reference = model.mesh.places(model.reference).to(theta)
        own = self._chain(self.response, self.reference)
        self.s = own.laplace
        # What the chain and the kind make of a receptance, over the noise.
        kind = self.s[:, None, None] ** DERIVATIVE[measurement.kind]
        self.weight = own.factor * kind * misfit.inverse
        self.weighted = self.weight.conj() * misfit.residual
        self.power = self.weight.abs().square()

    def _chain(self, response: Tensor, reference: Tensor) -> SensorChain:
        geometry, value = self.model.plan(self.theta).geometry, self.model.values(self.theta)
        chain = sensor_chain(laplace_lines(self.frequency, 0.0), response, reference)
        for label, effect in self.model.effects.items():
            chain = effect.observe(self.model.mesh, chain, value[label], geometry)
        return chain

    def _receptance(self, response: Tensor, reference: Tensor) -> Tensor:
        """Between places, the chain's factors taken off."""
        read = self.model.frf(self.theta, self.frequency, response.tolist(), reference.tolist(), "receptance")
        return read / self._chain(response, reference).factor

    def best(self, place: Float[Tensor, "n_place 2"]) -> tuple[Tensor, Tensor]:
        """For each line and place the best y, and the sum of squares Σ|α_jg α_gk|² that weighs it."""
        # Receptances are symmetric: the places as responses serve both ends, in one call.
        ends = self._receptance(place, torch.cat([self.response, self.reference]))
        n = len(self.response)
        left, right = ends[..., :n], ends[..., n:]  # [line, place, channel]
        on_right = torch.einsum("lgk,ljk->lgj", right.conj(), self.weighted)
        product = (left.conj() * on_right).sum(-1)
        size = ((right.abs().square() @ self.power.mT) * left.abs().square()).sum(-1)
        return -product / size.clamp(min=1e-300), size

    def index(self, y: Tensor, size: Tensor) -> Float[Tensor, " n_place"]:
        """Part of the misfit beyond noise explained, less what one free number for each line explains of anything."""
        misfit = self.misfit
        free = misfit.n_frf
        left = misfit.total - (size * y.abs().square()).sum(0)
        return (1 - (left * free / (free - 1) - misfit.noise) / misfit.excess).clamp(0.0, 1.0)

    def kinds(self, place: Float[Tensor, "n_place 2"]) -> list[tuple[dict[str, float], dict[str, float]]]:
        """At each place: what a spring, a dashpot, a mass alone and all three explain, and their sizes."""
        y, size = self.best(place)
        own = self._receptance(place, place).diagonal(dim1=-2, dim2=-1)
        found = []
        for index in range(len(place)):
            parts, values = {}, {}
            for name, power in KINDS.items():
                left, value = self._fitted(y[:, index], size[:, index], own[:, index], [power])
                parts[name], values[name] = self.misfit.part(left), float(value[0])
            left, _ = self._fitted(y[:, index], size[:, index], own[:, index], list(KINDS.values()))
            parts["place"] = max(self.misfit.part(left), *parts.values())
            found.append((parts, values))
        return found

    def polished(self, place: Float[Tensor, " 2"]) -> Float[Tensor, " 2"]:
        """The place nearby at which spring, dashpot and mass together explain most: sharper than a free force."""
        for step in POLISH:
            offset = torch.tensor([-step, 0.0, step]).to(place)
            around = (place + torch.cartesian_prod(offset, offset)).clamp(0.0, 1.0)
            y, size = self.best(around)
            own = self._receptance(around, around).diagonal(dim1=-2, dim2=-1)
            left = [
                self._fitted(y[:, index], size[:, index], own[:, index], list(KINDS.values()))[0]
                for index in range(len(around))
            ]
            place = around[left.index(min(left))]
        return place

    def _fitted(self, y: Tensor, size: Tensor, own: Tensor, powers: Sequence[int]) -> tuple[float, Tensor]:
        """Misfit left by z = Σ value s^power, and the values, from y = z (1 − y α_gg), each turn weighed anew.

        Source: Sanathanan and Koerner, IEEE Transactions on Automatic Control 8 (1963).
        """
        basis = torch.stack([self.s**power for power in powers], dim=-1)
        scale = basis.abs().square().mean(0).sqrt()
        basis = basis / scale
        columns = basis * (1 - y * own)[:, None]
        best, least = basis.real.new_zeros(len(powers)), math.inf
        weight = size.sqrt()
        base = self.misfit.total - float((size * y.abs().square()).sum())
        for turn in range(N_TURN):
            design, target = torch.view_as_real(columns * weight[:, None]), torch.view_as_real(y * weight)
            matrix = design.movedim(-1, 0).flatten(0, 1)
            value = torch.linalg.lstsq(matrix, target.mT.flatten()[:, None]).solution[:, 0]
            z = basis @ value.to(basis)
            slope = 1 / (1 + z * own)
            left = base + float((size * (y - z * slope).abs().square()).sum())
            if left < least:
                best, least = value, left
            elif turn > 2:
                break
            # y − z (1 − y α) = (y − z / (1 + z α)) (1 + z α).
            weight = size.sqrt() * slope.abs()
        return least, best / scale


def _force(
    misfit: _Misfit, measurement: Measurement, model: PlateModel, theta: Tensor
) -> tuple[ForceMap, Force] | None:
    """The map over the plate and the best place; None where it would say nothing."""
    shape = measurement.measured.shape
    if misfit.n_frf < LEAST_FRF or measurement.kind == "transmissibility":
        return None
    if any(isinstance(effect, ChannelSwap) for effect in model.effects.values()):
        # It speaks of FRFs of these channels alone, and the map asks for those to other places.
        return None
    if model.response is None or model.reference is None or (len(model.response), len(model.reference)) != shape:
        return None
    reach = _Reach(misfit, measurement, model, theta)
    side = torch.linspace(0.0, 1.0, N_PLACE, dtype=theta.dtype, device=theta.device)
    grid = torch.cartesian_prod(side, side).flip(-1)  # x runs first
    index = reach.index(*reach.best(grid)).reshape(N_PLACE, N_PLACE)
    places = _finer(reach, _peaks(index, side), 0.5 / (N_PLACE - 1))
    kinds = reach.kinds(places)
    scores = [parts["place"] for parts, _ in kinds]
    first = max(range(len(scores)), key=scores.__getitem__)
    places[first] = reach.polished(places[first])
    kinds[first] = reach.kinds(places[first : first + 1])[0]
    rounded = [(float(one[0]), float(one[1])) for one in places]
    others = tuple(
        rounded[one]
        for one in range(len(scores))
        if scores[one] > scores[first] - NEAR and float((places[one] - places[first]).abs().max()) > 0.1
    )
    free = float(reach.index(*reach.best(places[first : first + 1]))[0])
    return ForceMap(side, side, index), Force(rounded[first], others, free, *kinds[first])


def _peaks(index: Float[Tensor, "n_y n_x"], side: Float[Tensor, " n"]) -> Float[Tensor, "n_peak 2"]:
    """The highest places of the map that no neighbour tops."""
    top = torch.nn.functional.max_pool2d(index[None, None], 3, stride=1, padding=1)[0, 0]
    high = (index >= top) & (index >= index.max() - BELOW)
    row, column = high.nonzero(as_tuple=True)
    order = index[row, column].argsort(descending=True)[:N_PEAK]
    return torch.stack([side[column[order]], side[row[order]]], dim=-1)


def _finer(reach: _Reach, place: Float[Tensor, "n_place 2"], step: float) -> Float[Tensor, "n_place 2"]:
    """The best places around each, at most one step away, on a finer grid."""
    offset = torch.linspace(-step, step, 5, dtype=place.dtype, device=place.device)
    around = (place[:, None] + torch.cartesian_prod(offset, offset)).clamp(0.0, 1.0)
    index = reach.index(*reach.best(around.flatten(0, 1))).reshape(around.shape[:2])
    return around[torch.arange(len(place), device=place.device), index.argmax(1)]


def _percent(part: float) -> str:
    return f"{100 * part:.0f} %"


def _of_bands(bands: Sequence[Band]) -> str:
    total = sum(band.share for band in bands)
    ranges = [
        f"{band.low:.4g} Hz" if band.low == band.high else f"{band.low:.4g}-{band.high:.4g} Hz"
        for band in sorted(bands, key=lambda band: band.low)
    ]
    return f"{_percent(total)} of the misfit lies at {_joined(ranges)}."


def _joined(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _of_channels(channels: Sequence[ChannelGap]) -> str:
    worst, middle = channels[0], channels[len(channels) // 2]
    if len(channels) < 3 or worst.before < 2 * middle.before:
        return ""
    name = f"{worst.response}/{worst.reference}"
    return (
        f"The worst FRF is {name}, {_percent(worst.before)} off where the usual one is {_percent(middle.before)} off."
    )


def _of_kind(force: Force | None, chain: _Factor, one: _Factor) -> list[str]:
    """What explains most, in words: a place and kind, the sensor chain, or a channel."""
    at_place = 0.0 if force is None else force.parts["place"]
    # A factor that is the reason explains next to all; half can be had by turning down what sits at wrong frequencies.
    factor, own = (found.part if found.part >= NAMED_FACTOR else 0.0 for found in (chain, one))
    best = max(at_place, factor, own)
    said = []
    if best < NAMED:
        return ["No force at one place, no gain, no delay and no single channel explains the misfit."]
    if force is not None and at_place >= best - NEAR:
        rest = " That leaves too much for one place: something spread over the plate is as likely."
        said.append(_of_force(force) + (rest if at_place < NEARLY_ALL else ""))
    if factor >= best - NEAR:
        said.append(_of_chain(chain))
    if own >= best - NEAR > factor:
        sign = ": it carries the wrong sign" if abs(one.gain + 1) < 0.1 else ""
        said.append(f"A factor of {one.gain:.3g} on {one.channel} alone would explain {_percent(one.part)}{sign}.")
    if len(said) > 1:
        said.append("These data do not tell these apart by the misfit alone.")
    return said


def _of_force(force: Force) -> str:
    where = [f"({x:.2f}, {y:.2f})" for x, y in (force.place, *force.others)]
    place = " or ".join(where[:3])
    kind = max(KINDS, key=lambda name: force.parts[name])
    if force.parts[kind] >= force.parts["place"] - NEAR:
        size = f"{force.size[kind]:.3g} {UNIT[kind]}"
        return (
            f"A force at {place} that {WORDS[kind]}, about {size}) would explain {_percent(force.parts[kind])} of it."
        )
    mixed = ", ".join(f"{name} {_percent(force.parts[name])}" for name in KINDS)
    return f"A force at {place} would explain {_percent(force.parts['place'])} of it, but no single kind does: {mixed}."


def _of_chain(chain: _Factor) -> str:
    if chain.delay == 0.0:
        sign = ": all channels carry the wrong sign" if abs(chain.gain + 1) < 0.1 else ""
        return (
            f"The disagreement is common to all channels: a gain of {chain.gain:.4g} would explain "
            f"{_percent(chain.part)}: sensor chain{sign}."
        )
    gain = "" if chain.alone[1] >= chain.part - NEAR else f" and a gain of {chain.gain:.4g}"
    return (
        f"The disagreement is common to all channels and grows with frequency as a phase: a delay of "
        f"{1e3 * chain.delay:.3g} ms{gain} would explain {_percent(chain.part)}: sensor chain."
    )
