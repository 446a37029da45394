"""Receptances that are differentiable in everything, also where natural frequencies repeat.

The receptance is α = L Z⁻¹ Rᵀ, and the derivative of an inverse needs no derivative of a mode:

    dα = dL X + Y dRᵀ − Y dZ X,    X = Z⁻¹ Rᵀ, Y = L Z⁻¹,

the resolvent or adjoint form (Adelman and Haftka, AIAA J. 24 (1986) 823). The derivative of an eigenvector divides by
the gaps between eigenvalues (Fox and Kapoor, AIAA J. 6 (1968) 2426; Nelson, AIAA J. 14 (1976) 1201) and does not exist
where two of them are equal, as on every square plate; stock autograd through `torch.linalg.eigh` gives NaN there.

So the modes Φ are taken as a fixed basis. Since all of them are there, α = (LΦ) (ΦᵀZΦ)⁻¹ (RΦ)ᵀ whatever they are, and
its derivative at fixed Φ is exact. ΦᵀKΦ and ΦᵀMΦ happen to be diagonal, which makes every solve as cheap as the modal
sum; their derivatives are full matrices. The derivative of a solve is again a solve, so derivatives of any order
follow, in reverse and forward mode and under `torch.func`. Only forward mode inside forward mode is refused, because
torch drops the outer derivative of every custom function there (pytorch issue 197867); `jacrev(jacfwd(f))` and
`hessian(f)` give the same numbers.
"""

# ruff: noqa: ARG004  # torch says which arguments a custom function has, needed or not

from typing import Any

import torch
from jaxtyping import Complex, Float
from torch import Tensor
from torch.autograd import Function
from torch.nn.functional import pad

from torchplate.model.receptance.batched import stack_rows
from torchplate.model.receptance.impedance import (
    Impedance,
    adjoint_gradient,
    change_times,
    conjugate,
    contract,
    solve,
    times,
)
from torchplate.model.receptance.loewner import receptance_gradient
from torchplate.model.receptance.modal_receptance import receptance
from torchplate.model.receptance.modes import Modes, solve_modes
from torchplate.plate import System, transformed


def modal_impedance(system: System, modes: Modes, laplace: Complex[Tensor, "*#batch n_frequency"]) -> Impedance:
    """The impedance in the coordinates of the system's own modes, differentiable in the system and in s.

    Args:
        system: matrices of the model.
        modes: all its modes, from `frozen_modes`.
        laplace: s [1/s].
    """
    eigenvalue, shape = modes
    hysteretic = None if system.hysteretic is None else shape.mT @ system.hysteretic @ shape
    exponent, dispersion = system.proportional.loss_exponent, system.proportional.dispersion(laplace)
    return Impedance(
        _value_of(_ModalForm, system.stiffness, shape, eigenvalue),
        _value_of(_ModalForm, system.mass, shape, torch.ones_like(eigenvalue)),
        system.attached @ shape,
        system.force(laplace),
        *(torch.as_tensor(part).to(eigenvalue) for part in system.proportional[:4]),  # type: ignore[call-arg]  # four
        hysteretic,
        laplace,
        None if dispersion is None else torch.as_tensor(exponent).to(eigenvalue),
        dispersion,
    )


def frozen_modes(stiffness: Float[Tensor, "*#batch n n"], mass: Float[Tensor, "*#batch n n"]) -> Modes:
    """All modes of K φ = ω² M φ as constants: nothing is ever differentiated through them."""
    return Modes(*_value_of(_FrozenModes, stiffness.detach(), mass.detach()))


def differentiable_receptance(
    impedance: Impedance,
    response: Float[Tensor, "*#batch n_response n"],
    reference: Float[Tensor, "*#batch n_reference n"],
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
    """`receptance` [m/N] with exact derivatives of any order in all its arguments.

    Args:
        impedance: Z(s) in modal coordinates.
        response: modal deflections at the responses [1/√kg].
        reference: modal deflections at the references [1/√kg].
    """
    return _value_of(_Receptance, response, reference, *impedance)


def _value_of(function: type[Function], *inputs: Tensor | None) -> Any:
    """A function applied; straight where nothing can be differentiated: what torch does around it takes as long."""
    straight = not torch.is_grad_enabled() and not transformed()
    return function.forward(*inputs) if straight else function.apply(*inputs)


class _FrozenModes(Function):
    """Modes without a derivative; under vmap all members are solved together, checks of the eigenvectors included."""

    @staticmethod
    def forward(stiffness: Tensor, mass: Tensor) -> tuple[Tensor, Tensor]:
        modes = solve_modes(stiffness, mass)
        return modes.eigenvalue, modes.shape

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.mark_non_differentiable(*output)

    @staticmethod
    def backward(ctx: Any, *grad: Any) -> tuple[None, None]:
        return None, None

    @staticmethod
    def jvp(ctx: Any, *tangent: Any) -> tuple[None, None]:
        return None, None

    @staticmethod
    def vmap(info: Any, in_dims: Any, stiffness: Tensor, mass: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[int, int]]:
        matrices = (stiffness, mass)
        mapped = [m if at is None else m.movedim(at, 0) for m, at in zip(matrices, in_dims, strict=True)]
        n_batch = max(m.ndim - (at is not None) for m, at in zip(matrices, in_dims, strict=True))
        aligned = [
            m if at is None else m.reshape(len(m), *(1,) * (n_batch + 1 - m.ndim), *m.shape[1:])
            for m, at in zip(mapped, in_dims, strict=True)
        ]
        return _FrozenModes.apply(*aligned), (0, 0)


class _ModalForm(Function):
    """Φᵀ K Φ, known to be diagonal at the point where Φ was found: only its derivative costs a product."""

    generate_vmap_rule = True

    @staticmethod
    def forward(matrix: Tensor, shape: Tensor, diagonal: Tensor) -> Tensor:
        return torch.diag_embed(diagonal)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.save_for_backward(*inputs[:2])
        ctx.save_for_forward(*inputs[:2])

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        matrix, shape = ctx.saved_tensors
        return (shape @ grad @ shape.mT).sum_to_size(matrix.shape), None, None

    @staticmethod
    def jvp(ctx: Any, matrix: Tensor, *_: Any) -> Tensor:
        _refuse_nested_forward_mode()
        shape = ctx.saved_tensors[1]
        return shape.mT @ matrix @ shape


class _Solve(Function):
    """Rows x = Z⁻¹ r by line, r = weight · rows: rows that all lines share, mixed anew at each line."""

    generate_vmap_rule = True

    @staticmethod
    def forward(weight: Tensor, rows: Tensor, *inputs: Tensor | None) -> Tensor:
        return solve(Impedance(*inputs), weight, rows)  # type: ignore[arg-type]

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.save_for_backward(output, *inputs)
        ctx.save_for_forward(output, *inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        moved, weight, rows, *inputs = ctx.saved_tensors
        adjoint = _Solve.apply(conjugate(grad), torch.eye(grad.shape[-1]).to(rows), *inputs)
        return (
            conjugate(times(adjoint, rows.mT)).sum_to_size(weight.shape),
            contract(weight.expand(*adjoint.shape[:-1], weight.shape[-1]), adjoint).sum_to_size(rows.shape),
            *adjoint_gradient(Impedance(*inputs), adjoint, moved, ctx.needs_input_grad[2:]),
        )

    @staticmethod
    def jvp(ctx: Any, of_weight: Tensor | None, of_rows: Tensor | None, *tangents: Tensor | None) -> Tensor:
        _refuse_nested_forward_mode()
        moved, weight, rows, *inputs = ctx.saved_tensors
        change = -change_times(Impedance(*inputs), tangents, moved)
        if of_weight is not None:
            change = change + times(of_weight, rows)
        if of_rows is not None:
            change = change + times(weight, of_rows)
        return _Solve.apply(change, torch.eye(change.shape[-1]).to(rows), *inputs)


class _Receptance(Function):
    """L Z⁻¹ Rᵀ by the modal sum, and its derivative by the adjoint."""

    generate_vmap_rule = True

    @staticmethod
    def forward(left: Tensor, right: Tensor, *inputs: Tensor | None) -> Tensor:
        found = receptance(Impedance(*inputs).modal, left, right)  # type: ignore[arg-type]
        # Not a view of anything: forward mode through views of views fails inside torch.
        return found.clone(memory_format=torch.contiguous_format)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.save_for_backward(*inputs)
        ctx.save_for_forward(*inputs)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        left, right, *inputs = ctx.saved_tensors
        impedance = Impedance(*inputs)
        if impedance.hysteretic is None and not torch.is_grad_enabled():
            # Nobody will differentiate the derivative.
            return receptance_gradient(impedance, left, right, grad, ctx.needs_input_grad)
        # Z is symmetric, so either side may be the adjoint one: the fewer columns, the less to solve for.
        exchanged = left.shape[-2] < right.shape[-2]
        if exchanged:
            left, right, grad = right, left, grad.mT
        weight = conjugate(grad).mT
        n_left, n_right = left.shape[-2], right.shape[-2]
        own = torch.eye(n_right).to(weight).expand(*weight.shape[:-1], n_right)
        both = torch.cat([pad(own, (0, n_left)), pad(weight, (n_right, 0))], dim=-2)
        moved, adjoint = _Solve.apply(both, stack_rows(right, left), *inputs).tensor_split(2, dim=-2)
        sides: list[Tensor | None] = [None, None]
        needed = ctx.needs_input_grad[:2]
        if needed[exchanged]:
            sides[exchanged] = contract(weight, moved).sum_to_size(left.shape)
        if needed[not exchanged]:
            sides[not exchanged] = adjoint.real.sum(-3).sum_to_size(right.shape)
        return *sides, *adjoint_gradient(impedance, adjoint, moved, ctx.needs_input_grad[2:])

    @staticmethod
    def jvp(ctx: Any, of_left: Tensor | None, of_right: Tensor | None, *tangents: Tensor | None) -> Tensor:
        _refuse_nested_forward_mode()
        left, right, *inputs = ctx.saved_tensors
        rows = stack_rows(left, right)
        both = _Solve.apply(torch.eye(rows.shape[-2]).to(Impedance(*inputs).laplace)[None], rows, *inputs)
        moved_left, moved = both.split([left.shape[-2], right.shape[-2]], dim=-2)
        total = -moved_left @ change_times(Impedance(*inputs), tangents, moved).mT
        if of_left is not None:
            total = total + times(moved, of_left.mT).mT
        if of_right is not None:
            total = total + times(moved_left, of_right.mT)
        return total


def _refuse_nested_forward_mode() -> None:
    """Forward mode inside forward mode would be wrong without a word.

    Raises:
        NotImplementedError: if two forward-mode transforms are active.
    """
    active = torch._C._functorch.get_interpreter_stack() or []
    if sum(level.key() == torch._C._functorch.TransformType.Jvp for level in active) > 1:
        raise NotImplementedError(
            "Expected at most one forward-mode transform around the FRF, got one inside another, which torch gets "
            "wrong for custom functions. Use torch.func.jacrev for one of them, or torch.func.hessian."
        )
