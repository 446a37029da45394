"""A fitted model with a field in it, in one basis, and what each value of the field does to the FRFs."""

from dataclasses import replace
from typing import Final

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.discrepancy import Elements, Found, Specimens, matrix_columns
from torchplate.effects import Field, plate_scale
from torchplate.model import PlateModel, Searched
from torchplate.plate import Plan, stiffness_coefficient

LABEL: Final = "field"


class FieldModel:
    """One kind of field in one model.

    Args:
        builder: makes and evaluates models.
        fit: of the model without a field.
        kind: of the field.
        grid: its nodes.

    Attributes:
        whole: the model with the field, in all dofs; the field's values are searched.
        reduced: the same in a basis.
        unit: standard deviation of a value before anything is seen.
        low: least value.
    """

    def __init__(self, builder: ModelBuilder, fit: Fit, kind: str, grid: Grid) -> None:
        settings = builder.target.settings.inferring
        farthest = settings.farthest(builder.target.levels - 1)
        self.builder, self.kind, self.grid = builder, kind, grid
        self.effect = Field(kind=kind, n_x=grid.n_x, n_y=grid.n_y, directional=kind == "stiffness")
        base = builder.corrected(builder.adopt(fit.model), fit.theta).model
        self.base = base
        self.label = next(one for one in (LABEL, *(f"{LABEL}_{k}" for k in range(2, 99))) if one not in base.effects)
        plan = base.plan(fit.theta)
        scale = plate_scale("N/m", plan.section, plan.geometry)
        self.unit = {"loss": settings.loss, "support": settings.support * scale}.get(kind, settings.relative)
        # A negative spring to the ground would pass for a mass.
        self.low = 0.0 if kind in ("loss", "support") else settings.least - 1
        more = {f"{self.label}.{name}": Searched(self.low, farthest * self.unit) for name in self.effect.parameters}
        self.whole = base.replaced(
            effects={**base.effects, self.label: self.effect}, searched={**base.searched, **more}
        )
        names = self.whole.names
        self._own = torch.tensor([names.index(name) for name in base.names], dtype=torch.int64)
        self._value = torch.tensor([names.index(name) for name in more], dtype=torch.int64)
        self.rebased(fit.theta, fit.theta.new_zeros(len(more)))

    def rebased(self, theta: Float[Tensor, " n_own"], values: Float[Tensor, " n_value"]) -> None:
        """From here on in the modes of this plate."""
        every = self.joined(theta, values)
        self.reduced = self.builder.reduced(self.whole, every[None], by_element=True)
        self.specimens: Specimens = self.builder.target.specimens(self.reduced, every)
        plan = self.base.plan(theta)
        self._stiffness, self._mass = self._changes(plan)

    def joined(
        self, theta: Float[Tensor, "*#batch n_own"], values: Float[Tensor, "*#batch n_value"]
    ) -> Float[Tensor, "*batch n_parameter"]:
        """All parameters, in the model's order."""
        every = theta.new_zeros(*theta.shape[:-1], len(self.whole.names))
        every[..., self._own] = theta
        every[..., self._value] = values
        return every

    def as_known(self, values: Float[Tensor, " n_value"]) -> Field:
        """The effect with these values, as a config holds them."""
        return replace(self.effect, values=tuple(float(f"{one:.5g}") for one in values.tolist()))

    def specimen(self, about: Found | None) -> PlateModel:
        """The model of the specimen that was found."""
        return self.specimens.of(about)

    def columns(
        self,
        model: PlateModel,
        every: Float[Tensor, " n_parameter"],
        frequency: Float[Tensor, " n_frequency"],
        decay: float | Float[Tensor, " n_frequency"] = 0.0,
    ) -> Complex[Tensor, "n_value n_frequency n_response n_reference"]:
        """What a unit of each value adds to the FRFs, at s = iω + σ."""
        lossy = self.kind == "loss"
        return matrix_columns(model, every, frequency, self._stiffness, self._mass, decay, lossy)

    def _changes(self, plan: Plan) -> tuple[Tensor, Tensor]:
        """Stiffness and mass of a unit of each value beside no field, in the basis."""
        assembly, section = self.reduced.assembly, plan.section
        size, n = assembly.size, len(self.effect.parameters)
        nothing = self.base.known.new_zeros(n, size, size)
        if self.kind == "support":
            rows = assembly.rows(self.reduced.mesh.deflection_at(self.effect.nodes_at))
            return rows[:, :, None] * rows[:, None, :], nothing
        hats = self.effect.hats(self.base.mesh.element_place.to(self.base.known)).mT
        elements = Elements(self.reduced, plan)
        if self.kind == "mass":
            heavy = section.areal_mass / section.areal_mass.mean()
            return nothing, torch.stack([elements.mass(one * heavy) for one in hats])
        if self.effect.directional:
            factor = section.stiffness_factor.movedim(-1, 0)[..., None, None]
            along_x, along_y, cross, twist = factor * section.sound_parts
            changes = [
                stiffness_coefficient(one, plan.geometry)
                for one in (along_x + 0.5 * cross, along_y + 0.5 * cross, twist)
            ]
            found = torch.stack([elements.stiffness(hat, one) for one in changes for hat in hats])
            return 0.5 * (found + found.mT), nothing
        rigidity = section.rigidity.mean(-3)[None]
        stiff = section.rigidity[..., 0, 0] / rigidity[..., 0, 0]
        coefficient = stiffness_coefficient(rigidity, plan.geometry)
        found = torch.stack([elements.stiffness(one * stiff, coefficient) for one in hats])
        return 0.5 * (found + found.mT), nothing
