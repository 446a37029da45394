"""The specimen that was measured: a plate whose section wanders, and whose modes' damping is off its law.

How far a specimen is off is not known; what its FRFs say of that is put into the model, around which the rest is small
enough to be linear.

Source: Lindstrom and Bates, Nonlinear mixed effects models for repeated measures data, Biometrics 46 (1990) 673, for
linearising about the nuisances as they are found, and not about none.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy.wandering import Elements, Wandering, terms
from torchplate.model import PlateModel
from torchplate.model.extrapolation import on_mesh
from torchplate.plate import Correction, Unevenness


class Places(NamedTuple):
    """How far sensors and hits are off their marks along x and y, as FRFs say, in standard deviations.

    Attributes:
        response: posterior means.
        reference: likewise; none where the plate is shaken by its edges.
        response_left: posterior standard deviations.
        reference_left: likewise.
    """

    response: Float[Tensor, "n_response 2"]
    reference: Float[Tensor, "n_reference 2"]
    response_left: Float[Tensor, "n_response 2"]
    reference_left: Float[Tensor, "n_reference 2"]

    def within(self, most: float) -> "Places":
        """So many standard deviations at most."""
        return self._replace(response=self.response.clamp(-most, most), reference=self.reference.clamp(-most, most))

    def towards(self, other: "Places", part: float) -> "Places":
        """A part of the way to other places."""
        return Places(*(torch.lerp(one, there, part) for one, there in zip(self, other, strict=True)))

    @property
    def each(self) -> Float[Tensor, " n_off"]:
        """The means, one after another: x and y of each response, then of each reference."""
        return torch.cat([self.response.flatten(), self.reference.flatten()])


class Found(NamedTuple):
    """How a specimen and its test differ from a uniform plate whose damping obeys a law, tested at its marks.

    Attributes:
        shift: posterior means, in standard deviations: of each term of the section, then of ln damping of the lowest
            modes.
        spread: their posterior covariance.
        places: of sensors and hits; None where they are taken to be on their marks.
    """

    shift: Float[Tensor, " n_off"]
    spread: Float[Tensor, "n_off n_off"]
    places: Places | None = None

    def within(self, most: float) -> "Found":
        """Shifts of so many standard deviations at most: a model about farther ones would be no plate any more."""
        places = None if self.places is None else self.places.within(most)
        return self._replace(shift=self.shift.clamp(-most, most), places=places)

    def of(self, n: int) -> "Found":
        """The same for so many: modes that came in are as they may be, of those that left nothing is said."""
        old = min(n, len(self.shift))
        shift, spread = self.shift.new_zeros(n), torch.eye(n).to(self.spread)
        shift[:old], spread[:old, :old] = self.shift[:old], self.spread[:old, :old]
        return Found(shift, spread, self.places)


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

    def of(self, found: Found | None) -> PlateModel:
        """The model of the specimen that was found; the uniform plate where none was."""
        return self.uniform if found is None else self.at(found.shift, found.places)

    def at(self, shift: Float[Tensor, " n_off"], places: Places | None = None) -> PlateModel:
        """The model of a specimen so many standard deviations off in each, tested at these places."""
        terms, modes = shift[: self.n_term], shift[self.n_term :]
        stiffness, mass = (torch.einsum("t,tij->ij", terms.to(part), part) for part in (self.stiffness, self.mass))
        uneven = Unevenness(stiffness, mass, *self._measures)
        found = on_mesh(self.uniform, self.uniform.assembly.uneven(uneven))
        if len(modes) and self.damping > 0:
            found = found.with_damping_factors((self.damping * modes).exp())
        if places is None:
            return found
        reference = places.reference * self.place if len(places.reference) else None
        return found.with_places_off(places.response * self.place, reference)


def as_it_is_meant(model: PlateModel) -> PlateModel:
    """The model of a uniform plate whose damping obeys its law, tested at its marks, whatever it was before."""
    return on_mesh(model, model.assembly.uneven(None)).with_damping_factors(None).with_places_off(None)
