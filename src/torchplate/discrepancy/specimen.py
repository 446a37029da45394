"""The specimen that was measured: a plate whose section wanders, and whose modes' damping is off its law.

How far a specimen is off is not known; what its FRFs say of that is put into the model, around which the rest is small
enough to be linear.

Source: Lindstrom and Bates, Nonlinear mixed effects models for repeated measures data, Biometrics 46 (1990) 673, for
linearising about the nuisances as they are found, and not about none.
"""

from collections.abc import Container
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy.wandering import Elements, Wandering, terms
from torchplate.model import PlateModel, on_mesh
from torchplate.plate import Correction, Unevenness

# Levels of a channel that are put into a model [-]; what is farther off is linear about them.
LEVELS = (0.05, 20.0)


class OfChannels(NamedTuple):
    """What each channel of a test has of its own, and each support, as FRFs say, in standard deviations.

    Attributes:
        response: posterior means, for each response in the order of `of_response`.
        reference: likewise for each reference.
        response_left: posterior standard deviations.
        reference_left: likewise.
        of_response: what it is: "x" and "y", off the mark along a side; "level" and "drift", relative.
        of_reference: likewise.
        level: one standard deviation of a level [-].
        drift: of a record's frequencies [-].
        support: how far each support is off its mark along both sides; None where that is not among what is known.
        of_support: one standard deviation of that along each side, relative to it [-].
    """

    response: Float[Tensor, "n_response k_own"]
    reference: Float[Tensor, "n_reference k_other"]
    response_left: Float[Tensor, "n_response k_own"]
    reference_left: Float[Tensor, "n_reference k_other"]
    of_response: tuple[str, ...]
    of_reference: tuple[str, ...]
    level: float = 0.0
    drift: float = 0.0
    support: Float[Tensor, "n_support 2"] | None = None
    of_support: tuple[float, float] = (0.0, 0.0)

    def like(self, other: "OfChannels") -> bool:
        """Whether the same is known of as many channels."""
        names = (self.of_response, self.of_reference) == (other.of_response, other.of_reference)
        return names and all(a.shape == b.shape for a, b in zip(self[:2], other[:2], strict=True))

    def within(self, most: float) -> "OfChannels":
        """So many standard deviations at most, and levels of either sign that they have."""
        (low, high), (least, greatest) = self.limits(most)
        support = None if self.support is None else self.support.clamp(-most, most)
        return self._replace(
            response=self.response.clamp(low, high), reference=self.reference.clamp(least, greatest), support=support
        )

    def limits(self, most: float) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """The lowest and the highest of each column, of responses and of references.

        A level is put in as far as it goes: what was measured is divided by it.
        """
        found = []
        for names in (self.of_response, self.of_reference):
            ends = [
                [(end - 1) / max(self.level, 1e-12) for end in LEVELS] if name == "level" else [-most, most]
                for name in names
            ]
            low, high = self.response.new_tensor(ends).reshape(-1, 2).unbind(-1)
            found.append((low, high))
        return found[0], found[1]

    def towards(self, other: "OfChannels", part: float) -> "OfChannels":
        """A part of the way to others."""
        support = None if other.support is None else torch.lerp(self.supports(len(other.support)), other.support, part)
        return other._replace(
            response=torch.lerp(self.response, other.response, part),
            reference=torch.lerp(self.reference, other.reference, part),
            support=support,
        )

    def none(self) -> "OfChannels":
        """Channels that are as they are meant."""
        support = None if self.support is None else 0 * self.support
        return self._replace(response=0 * self.response, reference=0 * self.reference, support=support)

    def without_drift(self) -> "OfChannels":
        """The same with all records alike."""
        kept = [
            torch.tensor([float(one != "drift") for one in names]) for names in (self.of_response, self.of_reference)
        ]
        return self._replace(
            response=self.response * kept[0].to(self.response), reference=self.reference * kept[1].to(self.reference)
        )

    def from_each_other(self) -> "OfChannels":
        """The same, its drifts those of the records from each other.

        What all records have in common is a drift of the plate, which moves its modes as a modulus does. Taken for the
        channels' own it is nobody's: parameters follow it, what is linear stays behind, and each turn finds a little
        more of it.
        """
        found = []
        for values, names in ((self.response, self.of_response), (self.reference, self.of_reference)):
            if "drift" in names:
                values, at = values.clone(), names.index("drift")
                # Of a channel that no fit sees nothing is known, and it is where it was.
                seen = values[:, at] != 0
                values[seen, at] -= values[seen, at].mean()
            found.append(values)
        return self._replace(response=found[0], reference=found[1])

    def places(self) -> tuple[Tensor | None, Tensor | None]:
        """How far each response and each reference is off its mark; None where that is not among what is known."""
        return self._both("x", self.response, self.reference, 2)

    def supports(self, n: int) -> Float[Tensor, "n 2"]:
        """How far so many supports are off their marks; those that came in are on them."""
        found = self.response.new_zeros(n, 2)
        if self.support is not None:
            found[: len(self.support)] = self.support[:n]
        return found

    def places_left(self) -> tuple[Tensor | None, Tensor | None]:
        """How far they may be off still."""
        return self._both("x", self.response_left, self.reference_left, 2)

    def drift_left(self) -> float:
        """Root mean square of what is left of the drift of a record; 1 where none was found."""
        parts = [
            part[:, 0] for part in self._both("drift", self.response_left, self.reference_left, 1) if part is not None
        ]
        return float(torch.cat(parts).square().mean().sqrt()) if parts else 1.0

    def level_of_pairs(self) -> Float[Tensor, "#n_response #n_reference"]:
        """What the levels make of each FRF, a factor [-]."""
        found = self.response.new_ones(1, 1)
        of_response, of_reference = self._both("level", self.response, self.reference, 1)
        if of_response is not None:
            found = found * (1 + self.level * of_response)
        return found if of_reference is None else found * (1 + self.level * of_reference.mT)

    def drift_of_pairs(self) -> Float[Tensor, "#n_response #n_reference"] | None:
        """How much higher the natural frequencies of each FRF's record are [-]; None where that is not known."""
        of_response, of_reference = self._both("drift", self.response, self.reference, 1)
        if of_response is None or of_reference is None:
            found = of_response if of_reference is None else of_reference.mT
            return None if found is None else self.drift * found
        return self.drift * (of_response + of_reference.mT)

    def _both(self, what: str, response: Tensor, reference: Tensor, n: int) -> tuple[Tensor | None, Tensor | None]:
        found = []
        for part, names in ((response, self.of_response), (reference, self.of_reference)):
            at = names.index(what) if what in names else -1
            found.append(part[:, at : at + n] if at >= 0 else None)
        return found[0], found[1]


class Found(NamedTuple):
    """How a specimen and its test differ from a uniform plate whose damping obeys a law, tested at its marks.

    Attributes:
        shift: posterior means, in standard deviations: of each term of the section, then of ln damping of the lowest
            modes.
        spread: their posterior covariance.
        channels: what each of them has of its own; None where they are taken to be as they are meant.
        names: of the group that each term belongs to; empty where they were not kept.
    """

    shift: Float[Tensor, " n_off"]
    spread: Float[Tensor, "n_off n_off"]
    channels: OfChannels | None = None
    names: tuple[str, ...] = ()

    def without(self, groups: Container[str]) -> "Found":
        """The same with what was found of some groups put back, and known as well as it was."""
        kept = self.shift.new_tensor([float(name not in groups) for name in self.names])
        return self._replace(shift=self.shift * kept)

    def within(self, most: float) -> "Found":
        """Shifts of so many standard deviations at most: a model about farther ones would be no plate any more.

        Of what records drift, as far as they do from each other.
        """
        channels = None if self.channels is None else self.channels.within(most).from_each_other()
        return self._replace(shift=self.shift.clamp(-most, most), channels=channels)

    def as_sure_as(self, other: "Found") -> "Found":
        """The same, known as well as another is.

        What is not linear adds as much variance as is not known, and hypotheses are compared beside the same.
        """
        channels = self.channels
        if channels is not None and other.channels is not None and channels.like(other.channels):
            channels = channels._replace(
                response_left=other.channels.response_left, reference_left=other.channels.reference_left
            )
        return self._replace(spread=other.of(len(self.shift)).spread, channels=channels)

    def of(self, n: int) -> "Found":
        """The same for so many: modes that came in are as they may be, of those that left nothing is said."""
        old = min(n, len(self.shift))
        shift, spread = self.shift.new_zeros(n), torch.eye(n).to(self.spread)
        shift[:old], spread[:old, :old] = self.shift[:old], self.spread[:old, :old]
        names = (self.names + self.names[-1:] * n)[:n]
        return Found(shift, spread, self.channels, names)


class Specimens:
    """The specimens that a model may stand for: sections that wander, and modes whose damping is off its law.

    Args:
        model: in a basis.
        theta: its searched parameters where the terms are meant.
        wandering: how far the section may wander.
        damping: standard deviation of each mode's ln damping [-].
        n_mode: modes whose damping may be off.
        place: standard deviation of the place of a sensor or a hit [m].
    """

    @torch.no_grad()
    def __init__(
        self,
        model: PlateModel,
        theta: Float[Tensor, " n_parameter"],
        wandering: Wandering,
        damping: float = 0.0,
        n_mode: int = 0,
        place: float = 0.0,
    ) -> None:
        self.uniform = as_it_is_meant(model)
        self.damping = damping
        plan = model.plan(theta)
        self.place = place / torch.stack([plan.geometry.length_x.mean(), plan.geometry.length_y.mean()])
        elements = Elements(model, plan)
        every = terms(model, plan, wandering)
        self.n_term = len(every)
        self.names = tuple(one.name for one in every) + ("damping_scatter",) * (n_mode if damping > 0 else 0)
        matrices = [(elements.stiffness(one.stiffness, one.coefficient), elements.mass(one.mass)) for one in every]
        size = model.assembly.size
        plain = torch.zeros(0, size, size).to(model.known)
        self.stiffness, self.mass = (
            torch.stack([0.5 * (pair[k] + pair[k].mT) for pair in matrices]) if matrices else plain for k in (0, 1)
        )
        self._measures = (
            Correction.measure(plan.section.rigidity, plan.geometry),
            Unevenness.measure(plan.section.areal_mass, plan.geometry),
        )
        # The last one that was asked for: a Jacobian asks for that of its residual.
        self._last: tuple[Tensor, OfChannels | None, PlateModel] | None = None

    def of(self, found: Found | None) -> PlateModel:
        """The model of the specimen that was found; the uniform plate where none was."""
        return self.uniform if found is None else self.at(found.shift, found.channels)

    def at(self, shift: Float[Tensor, " n_off"], channels: OfChannels | None = None) -> PlateModel:
        """The model of a specimen so many standard deviations off in each, its sensors and hits where they are."""
        if self._last is None or self._last[1] is not channels or not torch.equal(self._last[0], shift):
            self._last = shift.clone(), channels, self._made(shift, channels)
        return self._last[2]

    def _made(self, shift: Float[Tensor, " n_off"], channels: OfChannels | None) -> PlateModel:
        terms, modes = shift[: self.n_term], shift[self.n_term :]
        stiffness, mass = (torch.einsum("t,tij->ij", terms.to(part), part) for part in (self.stiffness, self.mass))
        uneven = Unevenness(stiffness, mass, *self._measures)
        found = on_mesh(self.uniform, self.uniform.assembly.uneven(uneven))
        if len(modes) and self.damping > 0:
            found = found.with_damping_factors((self.damping * modes).exp())
        response, reference = (None, None) if channels is None else channels.places()
        if response is None:
            return found
        response, reference = where_read(self.uniform, response, reference)
        reference = None if reference is None else reference * self.place
        support = None
        if channels is not None and channels.support is not None:
            support = channels.support * channels.support.new_tensor(channels.of_support)
        return found.with_places_off(response * self.place, reference, support)


def where_read(model: PlateModel, response: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """What channels have of their own, in the order of the places that they are read from and not of their labels.

    Args:
        model: whose channels they are; two of them may be exchanged.
        response: of each response's label.
        reference: likewise; None where there are none.
    """
    from_response, from_reference = model.read_from()
    there = torch.empty_like(response)
    there[from_response] = response
    if reference is None:
        return there, None
    other = torch.empty_like(reference)
    other[from_reference] = reference
    return there, other


def as_it_is_meant(model: PlateModel) -> PlateModel:
    """The model of a uniform plate whose damping obeys its law, tested at its marks, whatever it was before."""
    return on_mesh(model, model.assembly.uneven(None)).with_damping_factors(None).with_places_off(None)
