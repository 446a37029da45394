"""A plate whose section wanders around its mean: smooth terms of thickness and modulus, and a grain.

Each term changes stiffness and mass of the elements by a standard deviation. How far a plate has each is not known.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.model import PlateModel
from torchplate.plate import Mesh, Plan, Section, Unevenness, stiffness_coefficient

# Step of the plate's section from which the change of its matrices is taken: they are polynomials of low order in it.
STEP = 1e-4
# Weights are a multiple of others to rounding, or they are not.
ALIKE = 1e-14


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


class Term(NamedTuple):
    """One way in which a section wanders, by one standard deviation.

    Attributes:
        name: of its group.
        stiffness: of each element, over that of `coefficient`.
        coefficient: what each stiffness pattern is times, in each element or in all of them.
        mass: more of each element, relative; None where there is none.
    """

    name: str
    stiffness: Float[Tensor, " n_element"]
    coefficient: Float[Tensor, "#n_element 6"]
    mass: Float[Tensor, " n_element"] | None


def terms(model: PlateModel, plan: Plan, wandering: Wandering) -> list[Term]:
    """All of them.

    What wanders is the plate with all that is in it: a patch that lost a half of the rigidity lost a half of what the
    thickness there adds to it, and everywhere else the plate wanders as it did without one.
    """
    section, place = plan.section, model.mesh.element_place.to(model.known)
    rigidity = section.rigidity
    coefficient = stiffness_coefficient(rigidity, plan.geometry)
    shapes = _shapes(place, wandering.order)
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
            other = stiffness_coefficient((changed.rigidity - rigidity) / STEP, plan.geometry)
            found.append(Term("grain", everywhere, other, None))
    return found


def _shapes(place: Float[Tensor, "*batch 2"], order: int) -> list[Float[Tensor, "*batch"]]:
    """Cosines at some relative places."""
    x, y = (math.pi * place).unbind(-1)
    pairs = [(k, total - k) for total in range(1, order + 1) for k in range(total + 1)]
    return [(p * x).cos() * (q * y).cos() for p, q in pairs]


def n_terms(wandering: Wandering) -> int:
    """How many terms there are."""
    n_shape = wandering.order * (wandering.order + 3) // 2
    return n_shape * ((wandering.thickness > 0) + (wandering.modulus > 0)) + 2 * (wandering.grain > 0)


def section_off(wandering: Wandering, shift: Float[Tensor, " n_term"]) -> Callable[[Mesh, Section], Section]:
    """What elements are made of on a plate that is so many standard deviations off in each term, each as a whole.

    Args:
        wandering: how far sections wander.
        shift: of each term.
    """

    def found(mesh: Mesh, section: Section) -> Section:
        shapes = _shapes(mesh.element_place.to(section.thickness), wandering.order)
        size = 1 / math.sqrt(sum(float(one.square().mean()) for one in shapes)) if shapes else 0.0
        left = iter(shift.tolist())
        off = {"thickness": 1.0, "youngs_modulus": 1.0}
        for one in shapes:
            for name, far in (("thickness", wandering.thickness), ("youngs_modulus", wandering.modulus)):
                if far > 0:
                    off[name] = off[name] + next(left) * far * size * one
        if wandering.grain > 0:
            off |= {name: 1 + next(left) * wandering.grain for name in ("young_ratio", "shear_factor")}
        return section._replace(**{name: getattr(section, name) * factor for name, factor in off.items()})

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
        self._last: tuple[Tensor, Tensor] | None = None
        self._alike: tuple[Tensor, Tensor] | None = None

    def stiffness(
        self, weight: Float[Tensor, " n_element"], coefficient: Float[Tensor, "#n_element 6"]
    ) -> Float[Tensor, "k k"]:
        """What elements of so many times these coefficients add."""
        # What the terms share is found once: an element's matrix takes the place of one of the two rows.
        known = self._turned.get(id(coefficient))
        if known is None:
            turned = torch.einsum("ek,kpq->epq", coefficient, self._assembly.pattern.to(self._rows)) @ self._rows
            known = self._turned[id(coefficient)] = (coefficient, turned.flatten(0, 1))
        weighed, multiple = self._weighed(weight)
        # Thickness and modulus wander alike: what one adds is a multiple of what the other does.
        if self._alike is None or self._alike[0] is not coefficient:
            self._alike = coefficient, weighed.mT @ known[1]
        return multiple * self._alike[1]

    def mass(self, weight: Float[Tensor, " n_element"] | None) -> Float[Tensor, "k k"]:
        """What elements heavier by these parts add."""
        if weight is None:
            return self._rows.new_zeros(self._rows.shape[-1], self._rows.shape[-1])
        weighed, multiple = self._weighed(weight)
        return multiple * (weighed.mT @ self._heavy)

    def _weighed(self, weight: Float[Tensor, " n_element"]) -> tuple[Tensor, float]:
        """Rows weighed by the elements, and what multiple of that is meant: of weights alike, those of the first."""
        if self._last is not None:
            first, weighed = self._last
            multiple = float(weight @ first) / max(float(first @ first), 1e-300)
            if float((weight - multiple * first).abs().max()) <= ALIKE * float(weight.abs().max()):
                return weighed, multiple
        self._last, self._alike = (weight, (self._rows * weight[:, None, None]).flatten(0, 1)), None
        return self._last[1], 1.0
