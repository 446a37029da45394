"""Where models are built and evaluated: one mesh for all, its error taken off, and bases that are right where used.

Every hypothesis is the baseline with one more effect. Those that are screened share one basis, of the baseline; those
that are refitted get a basis of their own, from the modes where they start and where they are, built anew as they move.
"""

import dataclasses
import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.candidate import Candidate
from torchplate.diagnosis.target import FrfTarget, Target
from torchplate.effects import Effect
from torchplate.model import PlateModel, Searched
from torchplate.model.extrapolation import Extrapolated, extrapolate, on_mesh
from torchplate.model.reduced_basis import ritz_basis
from torchplate.plate import Assembly, Mesh

# Elements of the working mesh, at least; the mesh twice as fine is used for the extrapolation alone.
LEAST_ELEMENTS = 256
# Modes kept, in multiples of the band's end.
MARGIN = 3.0
# What is left of a natural frequency's mesh error once it is extrapolated: a part of it, and something [-].
LEFT_PART, LEFT = 0.02, 3e-5


class Workbench:
    """Builds models of one plate and counts what they cost.

    Args:
        model: the given one.
        target: what it is held against.
        as_given: on the mesh as it is, with its error; else on a finer one whose error is taken off.
    """

    def __init__(self, model: PlateModel, target: Target, as_given: bool = False) -> None:
        self.target, self.as_given = target, as_given
        self.n_evaluation = 0
        self.mesh = model.mesh if as_given else working_mesh(model.mesh)
        self.split = self.mesh.refine // model.mesh.refine
        self._assembly = Assembly(self.mesh).to(model.known)
        self._finer: Assembly | None = None
        self.top = float(target.frequency.max()) if isinstance(target, FrfTarget) else 0.0
        self.n_mode = 0 if isinstance(target, FrfTarget) else int(target.mode.max()) + 1  # type: ignore[attr-defined]
        self.given = self.adopt(model)

    def adopt(self, model: PlateModel) -> PlateModel:
        """A model on the working mesh, in all dofs."""
        return on_mesh(model, self._assembly)

    def corrected(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Extrapolated:
        """A model whose mesh error at theta is taken off, and natural frequencies with their relative errors."""
        if self.as_given:
            nothing = theta.new_zeros(0)
            return Extrapolated(on_mesh(model, self._assembly), nothing, nothing)
        if self._finer is None:
            self._finer = Assembly(dataclasses.replace(self.mesh, refine=2 * self.mesh.refine)).to(model.known)
        plain = on_mesh(model, self._assembly)
        return extrapolate(plain, self.top or None, theta, self._finer)

    def reduced(
        self, model: PlateModel, members: Float[Tensor, "n_member n_parameter"], by_element: bool | None = None
    ) -> PlateModel:
        """A model in the modes of some of its members, and the static residual of the higher ones."""
        lines = torch.tensor([self.top]).to(model.known) if self.top else None
        basis = ritz_basis(model, members, lines, self.n_mode, MARGIN)
        if by_element is None:
            return model.projected(basis)
        return on_mesh(model, Assembly(self.mesh, basis, by_element, model.assembly.correction))

    def predict(self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"]) -> Tensor:
        """What a model says of the target."""
        self.n_evaluation += theta.shape[:-1].numel()
        return self.target.predict(model, theta)

    def shift(self, frequency: Tensor, error: Tensor) -> Float[Tensor, " n_frequency"]:
        """Standard deviation of what is left of the mesh error at each line, relative to the frequency [-]."""
        assert isinstance(self.target, FrfTarget)
        worst = error.abs().cummax(0).values
        at = torch.searchsorted(frequency.contiguous(), self.target.frequency.to(frequency)).clamp(max=len(worst) - 1)
        return LEFT + LEFT_PART * worst[at]


def working_mesh(mesh: Mesh) -> Mesh:
    """The mesh, split so that it has `LEAST_ELEMENTS` at least."""
    split = max(1, math.ceil(math.sqrt(LEAST_ELEMENTS / mesh.n_element)))
    return dataclasses.replace(mesh, refine=mesh.refine * split)


def with_candidate(model: PlateModel, label: str, candidate: Candidate) -> PlateModel:
    """The model with one more effect, whose parameters are searched."""
    return rebuilt(
        model,
        {**model.effects, label: candidate.effect},
        known_values(model),
        {**searched(model), **{f"{label}.{key}": interval for key, interval in candidate.searched.items()}},
    )


def without_effect(model: PlateModel, label: str) -> PlateModel:
    """The model with one effect less."""
    kept = {key: effect for key, effect in model.effects.items() if key != label}
    prefix = f"{label}."
    known = {key: value for key, value in known_values(model).items() if not key.startswith(prefix)}
    wanted = {key: interval for key, interval in searched(model).items() if not key.startswith(prefix)}
    return rebuilt(model, kept, known, wanted)


def with_numbers(model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> PlateModel:
    """The model with its searched parameters at these values: nothing is searched any more."""
    numbers = known_values(model) | dict(zip(model.names, theta.tolist(), strict=True))
    return rebuilt(model, model.effects, numbers, {})


def rebuilt(
    model: PlateModel, effects: Mapping[str, Effect], known: Mapping[str, float], wanted: Mapping[str, Searched]
) -> PlateModel:
    """A model of other effects or values on the same mesh, with the same assembly."""
    # The mesh is already what its effects have made of it.
    kept = {label: effect for label, effect in effects.items() if effect.name != "mesh_discretisation"}
    return PlateModel(
        model.mesh, kept, known, wanted, model.response, model.reference, model.kind, model.memory, model.assembly
    ).to(model.known.device)


def known_values(model: PlateModel) -> dict[str, float]:
    """Values of all that is not searched, by "label.parameter"."""
    values = iter(model.known.tolist())
    return {
        key: next(values)
        for label, effect in model.effects.items()
        for name in effect.parameters
        if (key := f"{label}.{name}") not in model.names
    }


def searched(model: PlateModel) -> dict[str, Searched]:
    """Intervals of all that is searched, by "label.parameter"."""
    space = model.space
    rows = zip(space.names, space.low.tolist(), space.high.tolist(), space.logarithmic.tolist(), strict=True)
    return {name: Searched(low, high, logarithmic) for name, low, high, logarithmic in rows}
