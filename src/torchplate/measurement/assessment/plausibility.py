"""Whether a model and a measurement can belong together at all, before any search: units, level, kind, frequencies.

What no value in the searched intervals mends is said, a sentence each, with what it looks like and how to write it.
Rough on purpose: members of the box stand for all of it, a few dozen modes of its middle are their basis, and only
what is off by a factor counts.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from scipy.sparse.linalg import ArpackNoConvergence
from scipy.special import bdtrc
from torch import Tensor

from torchplate.measurement.assessment.quality import CONJUGATE, peaks, runs_backwards, summed_amplitude
from torchplate.measurement.measurement import SI_UNIT, Kind, Measurement
from torchplate.measurement.natural_frequencies import NaturalFrequencies
from torchplate.model import DENSE, PlateModel, SparseModel, plate_mass, section_numbers, sizes


@dataclass(frozen=True)
class Limits:
    """From where on a disagreement is said.

    Args:
        n_mode: modes of the middle of the box that are the basis of all its members.
        n_line: lines at most at which FRFs are compared, evenly taken.
        n_corner: searched parameters up to which all corners of the box are looked at; else each end by itself.
        frequency: a table's natural frequencies are off where the median ratio is beyond this or one over it. What
            plates have that their models have not moves the median by 10 %; a number of another material by 1.5 and
            more, one unit mistaken for another by 2.5 and more (inch for cm).
        level: FRFs are off in level likewise, as medians over lines and pairs. A damping off by ten moves a median over
            the lines by less than two; g for m/s² is 9.81.
        near: a level within this factor of a known one looks like it.
        slope: how near the slope of log(measured/model) over log(frequency) is to a whole number, which says that the
            measurement is a derivative or an integral of what it is called.
        prominence: of a clear peak over its flanks [dB], and half of it over the median level.
        share: a count of modes and one of peaks disagree beyond this ratio, and this many more. Peaks are missed at
            nodal lines and where modes overlap, and noise adds some.
        width: how near a peak has to be to a natural frequency to be one of it [-]: a plate that is not quite the model
            has its modes a per cent apart from the model's, all in proportion.
        chance: with which peaks at random places may be as near to as many natural frequencies.
    """

    n_mode: int = 60
    n_line: int = 300
    n_corner: int = 4
    frequency: float = 1.3
    level: float = 3.0
    near: float = 1.7
    slope: float = 0.3
    prominence: float = 12.0
    share: float = 4.0
    width: float = 0.015
    chance: float = 0.01


LIMITS: Final = Limits()
# Frequencies within this factor of each other may be of one plate.
FITS: Final = 1.3
# Rigid-body modes of a free body; a plate that only bends has three of them at most.
IN_SPACE: Final = 6
# What the measured level is of the model's, where a unit is mistaken for another: what it looks like.
LEVELS: Final = (
    (1 / 9.80665, "g that are labelled m/s²", ("accelerance",)),
    (9.80665, "m/s² that are labelled g", ("accelerance",)),
    (1e3, "millimetres that are labelled metres, or kilonewtons that are labelled newtons", ()),
    (1e-3, "metres that are labelled millimetres, or newtons that are labelled kilonewtons", ()),
)
# What the measured natural frequencies are of those in Hz.
FREQUENCIES: Final = ((2 * math.pi, "rad/s", "divide by 2π"), (1e-3, "kHz", "multiply by 1000"))
# Sides of a plate so small that its coordinates may be in cm and not in mm [m]: `new` takes what is too large to be in
# m for mm, and few plates that are hit at several marks are smaller.
SMALL: Final = 0.15
LOOK: Final = (
    "They scale with thickness √(youngs_modulus / density) / side²: check these in m, Pa and kg/m³, and the supports "
    "and edges."
)
"""What to do where no unit explains it."""
REAL: Final = (
    "All FRFs are real numbers: without imaginary parts no peak has a width, and what is found of damping means "
    "nothing. If the export has left them out, export complex values."
)
ORDER: Final = ("receptance", "mobility", "accelerance")


def disagreements(
    model: PlateModel,
    measurement: Measurement | None = None,
    table: NaturalFrequencies | None = None,
    gain_is_unknown: bool = False,
    limits: Limits = LIMITS,
) -> tuple[str, ...]:
    """What no value in the intervals can mend, a sentence each; empty where the two can belong together.

    Args:
        model: with the measurement's responses, references and kind.
        measurement: FRFs, cut to the band.
        table: natural frequencies.
        gain_is_unknown: the level is fitted, and nothing is said of it.
        limits: from where on a disagreement is said.
    """
    with torch.no_grad():
        box = _Box(model, limits)
        found = [] if table is None else list(box.of_table(table))
        if measurement is not None:
            if runs_backwards(measurement.to("cpu")):
                found.append(f"{CONJUGATE[0].upper()}{CONJUGATE[1:]}. Write the complex conjugate of each.")
            if not bool(measurement.frf.imag.any()):
                found.append(REAL)
            counts = list(box.of_axis(measurement)) or list(box.of_counts(measurement))
            # A model whose frequencies are elsewhere says nothing of the level.
            found += counts or list(box.of_level(measurement.to(model.known.device), gain_is_unknown))
    return tuple(found)


class _Box:
    """Members that stand for the whole box of the searched parameters, in a basis of the modes of its middle."""

    def __init__(self, model: PlateModel, limits: Limits) -> None:
        self.model, self.limits = model, limits
        middle = model.space.to_si(torch.full_like(model.space.low, 0.5))
        size = model.assembly.size
        sparse, n_mode = SparseModel(model, middle), min(limits.n_mode, size)
        try:
            modes = sparse.modes(n_mode, dense=size <= DENSE)
        except ArpackNoConvergence:
            # Units far off put all eigenvalues close to the shift.
            modes = sparse.modes(n_mode, dense=True)
        self.twin = model.projected(modes.shape[:, : limits.n_mode])
        self.theta = model.space.to_si(_members(len(model.names), limits.n_corner).to(model.known))
        self.frequency = self.twin.natural_frequencies(self.theta, self.twin.assembly.size)
        self.n_rigid = min(_n_rigid(model), self.frequency.shape[-1] - 1)

    @property
    def first(self) -> tuple[float, float]:
        """The first natural frequency beyond the rigid-body modes [Hz], the lowest and the highest of the box."""
        first = self.frequency[:, self.n_rigid]
        return float(first.min()), float(first.max())

    def of_table(self, table: NaturalFrequencies) -> Iterator[str]:
        mode, value = table.mode.to(self.frequency.device), table.frequency.to(self.frequency)
        seen = mode <= self.frequency.shape[-1]
        flexible = seen & (mode > self.n_rigid)
        kept = flexible if bool(flexible.any()) else seen
        if not bool(kept.any()):
            return
        ratio = (self.frequency[:, mode[kept] - 1] / value[kept]).median(dim=-1).values
        low, high = float(ratio.min()), float(ratio.max())
        if low > self.limits.frequency or high < 1 / self.limits.frequency:

            def fits(scale: float) -> bool:
                return low * scale < FITS and high * scale > 1 / FITS

            if shifted := self._other_numbers(mode[kept], value[kept]):
                yield shifted
                return
            written = [f"if they are in {unit}, {action}" for factor, unit, action in FREQUENCIES if fits(factor)]
            given = section_numbers(self.model)
            measured = math.sqrt(math.prod(given.product) / (low * high))
            units = self._units(fits, otherwise=given.would_fit(measured))
            remedy = f"Measured ones are in Hz: {written[0]}." if written else units
            yield (
                f"The model's natural frequencies are {_span(low, high)} times the measured ones, whatever the values "
                f"in the intervals. {remedy}"
            )

    def _other_numbers(self, mode: Tensor, value: Tensor) -> str:
        """Where the modes' numbers leave the rigid-body modes out, or count six of them as a body in space has."""
        n = self.n_rigid
        counted = f"{n} rigid-body mode{'s' * (n > 1)}"
        for step, what in (
            (n, f"leave the plate's {counted} out"),
            (n - IN_SPACE, f"count {IN_SPACE} and not {counted}"),
        ):
            number = mode + step
            inside = (number > n) & (number <= self.frequency.shape[-1])
            if step == 0 or n == 0 or not bool(inside.all()):
                continue
            if len(value) > 1 and self._scatter(number, value) >= self._scatter(mode, value):
                continue
            ratio = (self.frequency[:, number - 1] / value).median(dim=-1).values
            if float(ratio.min()) < FITS and float(ratio.max()) > 1 / FITS:
                told = ", ".join(
                    f"{int(one)}: {float(hertz):g}" for one, hertz in zip(number[:3], value[:3], strict=True)
                )
                return (
                    f"The numbers of the natural frequencies seem to {what}: they would fit as "
                    f"{{{told}{', ...' * (len(number) > 3)}}}."
                )
        return ""

    def _scatter(self, number: Tensor, value: Tensor) -> float:
        """Of the model's natural frequencies of these numbers over the measured ones, in the member with the least."""
        return float((self.frequency[:, number - 1] / value).log().std(dim=-1).min())

    def of_axis(self, measurement: Measurement) -> Iterator[str]:
        """Where lines in rad/s are taken for Hz: peaks stand at 2π times the natural frequencies, and at none as it is.

        At 2π times as high a band a plate has as many times as many modes, and some of them are near any peak: what
        counts is how likely as many peaks at random places are as near.
        """
        turn, middle = 2 * math.pi, self.frequency[0, self.n_rigid :].cpu().numpy()
        below = float(self.frequency[:, : self.n_rigid].max()) if self.n_rigid else 0.0
        clear = np.array([one for one in _clear_peaks(measurement, self.limits.prominence) if one > 1.5 * turn * below])
        low, high = float(measurement.frequency[0]), float(measurement.frequency[-1])
        moves = min(self.first[0], middle[0]) > 0 and math.isfinite(self.first[1])
        if not moves or not len(clear) or float(self._count(low, high, 1.0).min()) <= self.limits.share * len(clear):
            return
        # All natural frequencies of the box go about in proportion.
        least, most = (math.log(one / middle[0]) for one in (0.95 * self.first[0], 1.05 * self.first[1]))
        stretches = np.exp(np.arange(least, most, self.limits.width))
        seen = [_nearby(clear, scale * middle, high, self.limits.width) for scale in (*(turn * stretches), *stretches)]
        as_turned, as_it_is = (min(some) for some in (seen[: len(stretches)], seen[len(stretches) :]))
        if as_turned[0] * len(stretches) < min(self.limits.chance, as_it_is[0]):
            yield (
                f"The frequency axis looks like rad/s that are taken for Hz: {as_turned[1]} of {len(clear)} clear "
                f"peaks, the first at {clear[0]:.4g}, lie at 2π times natural frequencies of the model, whose first "
                f"beyond rigid-body motion lies at {_span(*self.first)} Hz. Divide the frequencies by 2π; in a "
                "universal file (dataset 58) the unit label rad/s of the axis does that."
            )

    def of_counts(self, measurement: Measurement) -> Iterator[str]:
        low, high = float(measurement.frequency[0]), float(measurement.frequency[-1])
        clear = _clear_peaks(measurement, self.limits.prominence)
        every = len(peaks(measurement.to("cpu")))
        share = self.limits.share
        # More peaks than a third of the lines cannot be told apart.
        resolved = len(measurement.frequency) / 3

        def fewest(scale: float) -> int:
            return int(self._count(low, high, scale).min())

        def most(scale: float) -> int:
            return int(self._count(low / 1.2, high * 1.2, scale).max())

        def missed(scale: float) -> list[float]:
            """Clear peaks between rigid-body motion and the first of the other modes."""
            below = float(self.frequency[:, : self.n_rigid].max()) if self.n_rigid else 0.0
            first = scale * self.first[0]
            return [peak for peak in clear if 1.5 * below < peak < first / 1.5]

        def too_many(scale: float) -> bool:
            return min(fewest(scale), resolved) > share * (every + 1)

        def few_missed(scale: float) -> bool:
            # Rigid-body motion on its supports scales otherwise than bending.
            return len(missed(scale)) <= self.n_rigid

        if too_many(1.0):
            what, seen = f"some {fewest(1.0)} natural", f"{every} peaks"
        elif len(clear) > share * most(1.0) + 1:
            what, seen = f"{f'at most {most(1.0)}' if most(1.0) else 'no'} natural", f"{len(clear)} clear peaks"
        elif len(missed(1.0)) >= 2:
            yield (
                f"The measurement shows clear peaks at {_listed(missed(1.0))} Hz, where the model has no natural "
                f"frequency: its first beyond rigid-body motion lies at {_span(*self.first)} Hz, whatever the values "
                f"in the intervals. {self._units(lambda scale: few_missed(scale) and not too_many(scale))}"
            )
            return
        else:
            return

        def fits(scale: float) -> bool:
            return most(scale) >= len(clear) / 2 and fewest(scale) <= 2 * (every + 1) and few_missed(scale)

        first = f"; the first is at {clear[0]:.4g} Hz" if clear else ""
        yield (
            f"From {low:g} to {high:g} Hz the model has {what} frequencies, whatever the values in the intervals "
            f"(the first beyond rigid-body motion lies at {_span(*self.first)} Hz), and the measurement shows {seen}"
            f"{first}. {self._units(fits, axis=True)}"
        )

    def _count(self, low: float, high: float, scale: float) -> Float[Tensor, " n_member"]:
        """Natural frequencies in a band, all multiplied by `scale`; beyond the basis as dense as in it."""
        own = self.frequency * scale
        inside = ((own >= low) & (own <= high)).sum(-1).to(own)
        if self.twin.assembly.size == self.model.assembly.size:
            return inside
        last = own[:, -1]
        return inside + ((high - last.clamp(min=low)).clamp(min=0.0) * own.shape[-1] / last).floor()

    def of_level(self, measurement: Measurement, gain_is_unknown: bool) -> Iterator[str]:
        step = -(-len(measurement.frequency) // self.limits.n_line)
        # Beyond the last modes but a few the basis says nothing.
        top = float(self.frequency[:, -1].max()) / 1.2 if self.twin.assembly.size < self.model.assembly.size else None
        lines = measurement.frequency.to(self.frequency) > 0
        if top is not None:
            lines &= measurement.frequency.to(self.frequency) <= top
        index = torch.nonzero(lines).flatten()[::step]
        if len(index) < 10:
            return
        frequency = measurement.frequency.to(self.frequency)[index]
        model = self.twin.frf(self.theta, frequency).abs()
        measured = measurement.frf[index].abs().to(model)
        alive = measurement.measured & (measured > 0).all(0) & (model > 0).all(1).all(0)
        if not bool(alive.any()):
            return
        ratio = (measured[None][..., alive] / model[..., alive]).log()
        if order := self._order(ratio, frequency):
            yield _kind_sentence(measurement.kind, order)
        elif not gain_is_unknown:
            # The two medians by themselves, so that peaks that are not at one place do not count.
            own = model[..., alive].log().median(dim=1).values
            levels = (measured[..., alive].log().median(dim=0).values - own).median(dim=-1).values
            nearest = float(levels[levels.abs().argmin()])
            if abs(nearest) > math.log(self.limits.level):
                yield self._level_sentence(measurement.kind, math.exp(nearest))

    def _level_sentence(self, kind: Kind, factor: float) -> str:
        for known, text, kinds in LEVELS:
            if abs(math.log(factor / known)) < math.log(self.limits.near) and kind in (kinds or (kind,)):
                what = (
                    f"It looks like {text}, unless the plate's mass is not the {plate_mass(self.model)} kg that the "
                    f"model takes. Multiply the FRFs by {1 / known:.4g}, or correct the unit in the file"
                )
                break
        else:
            what = (
                f"Check its unit and calibration [{SI_UNIT[kind]}], that its lines are in Hz, and the plate's mass, "
                f"which the model takes as {plate_mass(self.model)} kg"
            )
        return (
            f"The measured level is {factor:.3g} times the model's, whatever the values in the intervals. {what}; or "
            "set measurement.gain: unknown, and the level is fitted."
        )

    def _order(self, ratio: Float[Tensor, "n_member n_line n_pair"], frequency: Float[Tensor, " n_line"]) -> int:
        """The power of the frequency by which all members are off, 0 if there is none or the band is too narrow."""
        if float(frequency[-1]) < 4 * float(frequency[0]):
            return 0
        x = frequency.log() - frequency.log().mean()
        slope = torch.einsum("l,mlp->mp", x, ratio).median(dim=-1).values / (x * x).sum()
        middle = float(slope.median())
        order = round(middle)
        return order if abs(middle - order) < self.limits.slope and bool((slope.round() == order).all()) else 0

    def _units(self, fits: Callable[[float], bool], axis: bool = False, otherwise: str = LOOK) -> str:
        """Which numbers of the plate, or of the frequency axis, look as if they were in another unit."""
        mesh = self.model.mesh
        guesses = []
        if max(mesh.length_x, mesh.length_y) < SMALL and fits(10**-2.0):
            sides = f"{10 * mesh.length_x:.3g} × {10 * mesh.length_y:.3g} m"
            guesses.append(f"the sides in centimetres that were read as millimetres ({sides})")
        for key, (quantity, span) in sizes(self.model).items():
            for unit, factor in quantity.meant(*span):
                name = key.rpartition(".")[2]
                if name == "length_y":
                    continue
                # All natural frequencies of a plate scale with h √(E/ρ) / L².
                power = {"length_x": -2.0, "thickness": 1.0, "youngs_modulus": 0.5, "density": -0.5}[name]
                if fits(factor**power):
                    subject = "the sides" if name == "length_x" else key
                    written = f" (write {span.times(factor).as_written()})" if name != "length_x" else ""
                    guesses.append(f"{subject} in {unit}{written}")
        guesses = guesses[:3]
        # What counts say of rad/s is too little: `of_axis` looks at where the peaks stand.
        guesses += ["a frequency axis in kHz (multiply by 1000)"] if axis and fits(1e-3) else []
        if guesses:
            return f"It would fit {' or '.join(guesses)}."
        return otherwise


def _members(n_parameter: int, n_corner: int) -> Float[Tensor, "n_member n_parameter"]:
    """The middle of the unit cube, and its corners; of many parameters, each end by itself and all ends together."""
    middle = torch.full((1, n_parameter), 0.5, dtype=torch.float64)
    if n_parameter == 0:
        return middle
    if n_parameter <= n_corner:
        corners = torch.tensor(list(product((0.0, 1.0), repeat=n_parameter)), dtype=torch.float64)
    else:
        one = torch.eye(n_parameter, dtype=torch.float64)
        corners = torch.cat([0.5 * (1 - one), 0.5 * (1 + one), 0 * middle, 2 * middle])
    return torch.cat([middle, corners])


def _n_rigid(model: PlateModel) -> int:
    """Rigid-body modes of the plate itself, supports left out."""
    held = [edge for edge, condition in model.mesh.edges.items() if condition != "free"]
    if not held:
        return 3
    # On one simply supported edge the plate turns as a door.
    return 1 if len(held) == 1 and model.mesh.edges[held[0]] == "simply_supported" else 0


def _clear_peaks(measurement: Measurement, prominence: float) -> list[float]:
    """Peaks [Hz] that stand out of the whole band as well as of their flanks."""
    on_cpu = measurement.to("cpu")
    found = peaks(on_cpu, prominence)
    decibel = 20 * np.log10(summed_amplitude(on_cpu).clamp(min=1e-300).numpy())
    index = np.searchsorted(on_cpu.frequency.numpy(), found)
    over = decibel[index] - np.median(decibel) > prominence / 2
    return [frequency for frequency, kept in zip(found, over, strict=True) if kept]


def _nearby(
    peaks: Float[np.ndarray, " n_peak"], modes: Float[np.ndarray, " n_mode"], high: float, width: float
) -> tuple[float, int]:
    """How likely as many of some peaks are as near to modes by chance, and how many are.

    Args:
        peaks: ascending [Hz].
        modes: ascending [Hz].
        high: end of the band [Hz].
        width: from where on a peak is near, relative [-].
    """
    inside = np.log(modes[(modes > peaks[0] / 1.1) & (modes < 1.1 * high)])
    if not len(inside):
        return 1.0, 0
    n_near = int((np.abs(np.log(peaks)[:, None] - inside).min(-1) < width).sum())
    gaps = np.diff(inside).clip(max=2 * width).sum() + 2 * width
    covered = min(1.0, float(gaps / math.log(1.1 * high / (peaks[0] / 1.1))))
    return float(bdtrc(n_near - 1, len(peaks), covered)) if n_near else 1.0, n_near


def _kind_sentence(kind: Kind, order: int) -> str:
    place = ORDER.index(kind) + order if kind in ORDER else -1
    if 0 <= place < len(ORDER):
        looks, action = ORDER[place], f"Set measurement.kind: {ORDER[place]}, or correct the file's specifiers"
    else:
        looks, action = "another quantity", "Check what the analyser has exported"
    return (
        f"Over the model's, the measured FRFs {'rise' if order > 0 else 'fall'} with the frequency to the power "
        f"{abs(order)}: they look like {looks}, not {kind}. {action}."
    )


def _listed(frequencies: list[float]) -> str:
    more = f" and {len(frequencies) - 4} more up to {frequencies[-1]:.4g}" if len(frequencies) > 4 else ""
    return ", ".join(f"{frequency:.4g}" for frequency in frequencies[:4]) + more


def _span(low: float, high: float) -> str:
    return f"{low:.3g}" if high <= 1.01 * low else f"{low:.3g} to {high:.3g}"
