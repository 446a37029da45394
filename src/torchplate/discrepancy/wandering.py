"""A plate whose section wanders around its mean: smooth terms of thickness and modulus, and a grain.

Each term changes stiffness and mass of the elements by a standard deviation. How far a plate has each is not known;
what its FRFs say of that can be put into a model (`wandered`), around which the rest is small enough to be linear.

Source: Lindstrom and Bates, Nonlinear mixed effects models for repeated measures data, Biometrics 46 (1990) 673, for
linearising about the nuisances as they are found, and not about none.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model import PlateModel
from torchplate.model.extrapolation import on_mesh
from torchplate.plate import Correction, Plan, Unevenness

# Step of the plate's section from which the change of its matrices is taken: they are polynomials of low order in it.
STEP = 1e-4


@dataclass(frozen=True)
class Wandering:
    """How far a plate's section is from uniform; standard deviations at a place, relative [-].

    Args:
        thickness: cold-rolled sheet keeps its thickness to about half a per cent within a sheet.
        modulus: of Young's modulus, likewise.
        grain: of E_y/E_x and of the shear modulus over the isotropic one, the whole plate alike: rolling leaves a
            texture.
        order: of the cosines cos(pπx) cos(qπy), p + q from 1 to this.
    """

    thickness: float = 5e-3
    modulus: float = 5e-3
    grain: float = 1e-2
    order: int = 3


# A plate that is the same everywhere.
UNIFORM = Wandering(0.0, 0.0, 0.0, 0)


class Found(NamedTuple):
    """How a specimen differs from a uniform plate whose damping obeys a law, as FRFs say.

    Attributes:
        shift: posterior means, in standard deviations: of each term of the section, then of ln damping of the lowest
            modes.
        spread: their posterior covariance.
    """

    shift: Float[Tensor, " n_off"]
    spread: Float[Tensor, "n_off n_off"]

    def within(self, most: float) -> "Found":
        """Shifts of so many standard deviations at most: a model about farther ones would be no plate any more."""
        return self._replace(shift=self.shift.clamp(-most, most))

    def of(self, n: int) -> "Found":
        """The same for so many: modes that came in are as they may be, of those that left nothing is said."""
        old = min(n, len(self.shift))
        shift, spread = self.shift.new_zeros(n), torch.eye(n).to(self.spread)
        shift[:old], spread[:old, :old] = self.shift[:old], self.spread[:old, :old]
        return Found(shift, spread)


class Term(NamedTuple):
    """One way in which a section wanders, by one standard deviation.

    Attributes:
        name: of its group.
        stiffness: of each element, over that of `coefficient`.
        coefficient: what each stiffness pattern is times.
        mass: more of each element, relative; None where there is none.
    """

    name: str
    stiffness: Float[Tensor, " n_element"]
    coefficient: Float[Tensor, " 6"]
    mass: Float[Tensor, " n_element"] | None


def terms(model: PlateModel, plan: Plan, wandering: Wandering) -> list[Term]:
    """All of them.

    What wanders is the plate around its mean section: patches of other stiffness in it count as the rest does.
    """
    section, place = plan.section, model.mesh.element_place.to(model.known)
    rigidity = section.rigidity.mean(-3)[None]
    coefficient = model.assembly.stiffness_coefficient(rigidity, plan.geometry)[0]
    shapes = [
        (math.pi * p * place[:, 0]).cos() * (math.pi * q * place[:, 1]).cos()
        for total in range(1, wandering.order + 1)
        for p, q in ((k, total - k) for k in range(total + 1))
    ]
    # So that all terms together are as large as the standard deviation says, on the mean over the plate.
    size = 1 / math.sqrt(sum(float(one.square().mean()) for one in shapes)) if shapes else 0.0
    found = []
    for one in shapes:
        if wandering.thickness > 0:
            thicker = wandering.thickness * size * one
            found.append(Term("thickness", 3 * thicker, coefficient, thicker))
        if wandering.modulus > 0:
            found.append(Term("modulus", wandering.modulus * size * one, coefficient, None))
    if wandering.grain > 0:
        everywhere = torch.full_like(place[:, 0], wandering.grain)
        for changed in (
            section._replace(young_ratio=section.young_ratio * (1 + STEP)),
            section._replace(shear_factor=section.shear_factor * (1 + STEP)),
        ):
            change = (changed.rigidity.mean(-3)[None] - rigidity) / STEP
            other = model.assembly.stiffness_coefficient(change, plan.geometry)[0]
            found.append(Term("grain", everywhere, other, None))
    return found


class Elements:
    """A model's elements in some coordinates: what changes of them add to its matrices.

    Args:
        model: whose elements they are.
        plan: of its parameters.
        shape: columns over the rows of its matrices; left out, these themselves.
    """

    def __init__(self, model: PlateModel, plan: Plan, shape: Float[Tensor, "n k"] | None = None) -> None:
        rows = model.assembly.element_rows()
        self._rows = rows if shape is None else rows @ shape
        self._assembly = model.assembly
        heavy = float(Unevenness.measure(plan.section.areal_mass, plan.geometry))
        self._heavy = heavy * (model.assembly.mass_pattern.to(rows) @ self._rows).flatten(0, 1)
        self._turned: dict[int, tuple[Tensor, Tensor]] = {}

    def stiffness(self, weight: Float[Tensor, " n_element"], coefficient: Float[Tensor, " 6"]) -> Float[Tensor, "k k"]:
        """What elements of so many times these coefficients add."""
        # An element's matrix is the same everywhere: it takes the place of one of the two rows.
        known = self._turned.get(id(coefficient))
        if known is None:
            turned = torch.einsum("k,kpq->pq", coefficient, self._assembly.pattern.to(self._rows)) @ self._rows
            known = self._turned[id(coefficient)] = (coefficient, turned.flatten(0, 1))
        return self._weighed(weight).mT @ known[1]

    def mass(self, weight: Float[Tensor, " n_element"] | None) -> Float[Tensor, "k k"]:
        """What elements heavier by these parts add."""
        if weight is None:
            return self._rows.new_zeros(self._rows.shape[-1], self._rows.shape[-1])
        return self._weighed(weight).mT @ self._heavy

    def _weighed(self, weight: Tensor) -> Tensor:
        return (self._rows * weight[:, None, None]).flatten(0, 1)


class Specimens:
    """The specimens that a model may stand for: sections that wander, and modes whose damping is off its law.

    Args:
        model: in a basis.
        theta: its searched parameters where the terms are meant.
        wandering: how far the section may wander.
        damping: standard deviation of each mode's ln damping [-].
        n_mode: modes whose damping may be off.
    """

    @torch.no_grad()
    def __init__(
        self,
        model: PlateModel,
        theta: Float[Tensor, " n_parameter"],
        wandering: Wandering,
        damping: float = 0.0,
        n_mode: int = 0,
    ) -> None:
        self.uniform = as_it_is_meant(model)
        self.damping = damping
        plan = model.plan(theta)
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

    def at(self, shift: Float[Tensor, " n_off"]) -> PlateModel:
        """The model of a specimen so many standard deviations off in each."""
        terms, modes = shift[: self.n_term], shift[self.n_term :]
        stiffness, mass = (torch.einsum("t,tij->ij", terms.to(part), part) for part in (self.stiffness, self.mass))
        uneven = Unevenness(stiffness, mass, *self._measures)
        found = on_mesh(self.uniform, self.uniform.assembly.uneven(uneven))
        return found.with_damping_factors((self.damping * modes).exp()) if len(modes) and self.damping > 0 else found


def as_it_is_meant(model: PlateModel) -> PlateModel:
    """The model of a uniform plate whose damping obeys its law, whatever it was before."""
    return on_mesh(model, model.assembly.uneven(None)).with_damping_factors(None)


def wandered(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    wandering: Wandering,
    found: Found | None,
    damping: float = 0.0,
) -> PlateModel:
    """The model of a specimen, in the place of any that it was before.

    Args:
        model: in a basis.
        theta: its searched parameters where the terms are meant.
        wandering: how far its section may wander.
        found: how far off it is; None where it is not.
        damping: standard deviation of each mode's ln damping [-].
    """
    if found is None:
        return as_it_is_meant(model)
    return Specimens(model, theta, wandering, damping).at(found.shift)
