"""Modal sums with terms attached, block of lines by block of lines: values in place, and their gradient by the adjoint.

`modal_sum` and `attach` say what is computed, in operations that may be differentiated in any way and as often as one
likes. Here the same is done for plates that share their modes, where a population is one long row of lines, in arrays
that are written over and so stay in the cache. `attach.weights` says what stands before the derivative of G; that of G
in z is that of its features, 1 / (λ − z)² of near modes and T_k' = k U_(k−1) of the series.

Derivatives of derivatives, forward mode and `torch.func` go through the plain operations.
"""

# ruff: noqa: ARG004  # torch says which arguments a custom function has, needed or not

import functools
import math
import threading
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor
from torch.autograd import Function

from torchplate.model.receptance.attach import attach, attach_, weights_
from torchplate.model.receptance.batched import joined
from torchplate.model.receptance.modal_sum import Stretch, as_complex, as_real, modal_sum, pairs_of
from torchplate.plate import transformed

# Numbers in an array that is kept from call to call.
KEPT = 2**20
# Members with rows of their own that go together.
MEMBERS_AT_ONCE = 32


class Rows(NamedTuple):
    """Modes, and where they are read and pushed."""

    eigenvalue: Float[Tensor, "*#batch n"]  # λ, lowest first [rad²/s²]
    left: Float[Tensor, "*#batch n_left n"]  # at the terms, then the responses [1/√kg]
    right: Float[Tensor, "*#batch n_right n"]  # at the terms, then the references [1/√kg]

    @property
    def alike(self) -> bool:
        """Whether all members have the same ones."""
        return self.eigenvalue.ndim == 1 and self.left.ndim == self.right.ndim == 2


def attached_sum(
    rows: Rows,
    z: Complex[Tensor, "*batch n_frequency"],
    force: Complex[Tensor, "n_term *batch n_frequency"],
    stretches: Sequence[Stretch],
    at_once: int,
    scale: Complex[Tensor, "*#batch #n_frequency"],
    in_single: bool = False,
) -> Complex[Tensor, "n_response n_reference *batch n_frequency"]:
    """G between responses and references with all terms attached, times a scale, differentiable in everything.

    Args:
        rows: modes and where they are read.
        z: −μ/κ [rad²/s²].
        force: D of each term, in the units of 1 / G.
        stretches: of each block of lines.
        at_once: lines in a block.
        scale: what the sum is multiplied by, 1 / eκ.
        in_single: single precision, for values alone.
    """
    moving = torch.is_grad_enabled() and any(part.requires_grad for part in rows)
    if moving or transformed() or (not rows.alike and (torch.is_grad_enabled() or rows.eigenvalue.ndim > 1)):
        return _plain(rows, z, force, stretches, at_once) * scale
    if not rows.alike:
        beside = _beside_common(rows, z, force, stretches, at_once)
        return _values_of_each(rows, z, force, stretches, at_once, scale) if beside is None else beside * scale
    if torch.is_grad_enabled():
        return _AttachedSum.apply(z, force, rows, stretches, at_once) * scale
    return _values(rows, z, force, stretches, at_once, scale, in_single)


def _plain(rows: Rows, z: Tensor, force: Tensor, stretches: Sequence[Stretch], at_once: int) -> Tensor:
    blocks = zip(z.split(at_once, dim=-1), force.split(at_once, dim=-1), stretches, strict=True)
    return joined([attach(modal_sum(*rows, own, stretch), tied) for own, tied, stretch in blocks], -1)


def _values(
    rows: Rows,
    z: Tensor,
    force: Tensor,
    stretches: Sequence[Stretch],
    at_once: int,
    scale: Tensor | None = None,
    in_single: bool = False,
) -> Tensor:
    n, shape, dtype = len(force), z.shape, torch.complex64 if in_single else z.dtype
    found = z.new_empty(len(rows.left) - n, len(rows.right) - n, *shape, dtype=dtype)
    if scale is not None:
        scale = scale.to(dtype).expand(shape)
    for lines, block in _blocks(rows, z, force, stretches, at_once, in_single):
        own = block.attached().unflatten(-1, (*shape[:-1], -1))
        found[..., lines] = own if scale is None else own.mul_(scale[..., lines])
    return found


def _values_of_each(
    rows: Rows, z: Tensor, force: Tensor, stretches: Sequence[Stretch], at_once: int, scale: Tensor
) -> Tensor:
    """As `_values`, of members that have rows of their own: some members at a time."""
    n_term, n_line, batch = len(force), z.shape[-1], z.shape[:-1]
    left, right = (side.expand(*batch, *side.shape[-2:]).flatten(0, -3) for side in rows[1:])
    n_left, n_right = left.shape[-2], right.shape[-2]
    of_member = z.reshape(-1, n_line)
    of_term = force.reshape(n_term, *of_member.shape)
    n_member, n_point = min(MEMBERS_AT_ONCE, len(of_member)), min(at_once, n_line)
    found = z.new_empty(n_left - n_term, n_right - n_term, *of_member.shape)
    sizes = [(s.last - s.first, 0 if s.series is None else s.series.shape[-1]) for s in stretches]
    kinds = (("real", z.real.dtype), ("feature", z.dtype), ("found", z.dtype))
    numbers = 2 * max(near for near, _ in sizes), max(map(sum, sizes)), n_left * n_right
    room = [
        _room(name, n * n_member * n_point, dtype, z.device) for (name, dtype), n in zip(kinds, numbers, strict=True)
    ]
    for first in range(0, len(of_member), n_member):
        members = slice(first, first + n_member)
        pairs = pairs_of(left[members], right[members])
        for index, ((near, slow), stretch) in enumerate(zip(sizes, stretches, strict=True)):
            lines = slice(index * at_once, (index + 1) * at_once)
            own, tied = of_member[members, lines], of_term[:, members, lines]
            shapes = (2, len(own), near), (len(own), near + slow), (len(own), n_left * n_right)
            real, feature, among = (
                part[: torch.Size(shape).numel() * own.shape[-1]].view(*shape, own.shape[-1])
                for part, shape in zip(room, shapes, strict=True)
            )
            _write_features(stretch, rows.eigenvalue, own, real, feature)
            torch.bmm(stretch.weights(pairs), as_real(feature), out=as_real(among))
            apart = among.view(len(own), n_left, n_right, own.shape[-1]).movedim(0, 2)
            found[:, :, members, lines] = attach_(apart, tied)
    return found.view(*found.shape[:2], *z.shape) * scale


def _beside_common(rows: Rows, z: Tensor, force: Tensor, stretches: Sequence[Stretch], at_once: int) -> Tensor | None:
    """As `_values_of_each` but for the scale, where members differ in their last terms alone; None where in more.

    What all have in common is summed and attached once. Terms are attached one after the other: each takes the product
    of its column and its row from all that is left, G − G_·t D / (1 + D G_tt) G_t·.
    """
    n_term, n_line, batch = len(force), z.shape[-1], z.shape[:-1]
    of_member = z.reshape(-1, n_line)
    of_term = force.reshape(n_term, *of_member.shape)
    left, right = (side.expand(*batch, *side.shape[-2:]).flatten(0, -3) for side in rows[1:])
    same = (of_term == of_term[:, :1]).all(-1).all(-1)
    alike_left, alike_right = ((side == side[:1]).all(-1).all(0) for side in (left, right))
    same = same & alike_left[:n_term] & alike_right[:n_term]
    n = int(same.to(torch.int64).cumprod(0).sum())
    ends = bool(alike_left[n_term:].all() and alike_right[n_term:].all())
    if not 0 < n < n_term or not ends or not bool((of_member == of_member[:1]).all()):
        return None
    of_all = [torch.cat([side[0, :n], side[0, n_term:]]) for side in (left, right)]
    moved = [side[:, n:n_term] for side in (left, right)]
    found = z.new_empty(left.shape[-2] - n_term, right.shape[-2] - n_term, *of_member.shape)
    for index, stretch in enumerate(stretches):
        lines = slice(index * at_once, (index + 1) * at_once)
        feature = as_real(stretch.features(rows.eigenvalue, of_member[0, lines]))

        between = functools.partial(_between, stretch, feature)
        among, tied = between(*of_all), of_term[:, :, lines]
        for first in range(0, len(of_member), MEMBERS_AT_ONCE):
            members = slice(first, first + MEMBERS_AT_ONCE)
            own, other = (side[members] for side in moved)
            parts = between(own, of_all[1]), between(of_all[0], other), between(own, other)
            found[:, :, members, lines] = _attached_after(among, *parts, tied[:, members])
    return found.view(*found.shape[:2], *z.shape)


def _between(stretch: Stretch, feature: Tensor, one: Tensor, other: Tensor) -> Tensor:
    """G with nothing attached, rows and columns first, members after them [n_one, n_other, *member, point]."""
    pairs = as_complex(stretch.weights(pairs_of(one, other)) @ feature)
    return pairs.unflatten(-2, (one.shape[-2], other.shape[-2])).movedim((-3, -2), (0, 1))


def _attached_after(among: Tensor, row: Tensor, column: Tensor, own: Tensor, force: Tensor) -> Tensor:
    """G between responses and references, first the common terms attached and then those of each member.

    Args:
        among: G between what is common, its terms first [n_left, n_right, point].
        row: from the members' own terms to that [n_own, n_right, member, point].
        column: and back [n_left, n_own, member, point].
        own: among themselves [n_own, n_own, member, point].
        force: D of all terms [n_term, member, point].
    """
    n = len(force) - len(own)
    for index in range(n):
        stiffness = force[index, 0]
        along = among[0, 1:] * (stiffness / (1 + stiffness * among[0, 0]))
        to_own = column[0] * (stiffness / (1 + stiffness * among[0, 0]))
        down, down_own = among[1:, 0], row[:, 0]
        among = among[1:, 1:] - down[:, None] * along
        row = torch.addcmul(row[:, 1:], down_own[:, None], along[None, :, None], value=-1)
        column = torch.addcmul(column[1:], down[:, None, None], to_own[None], value=-1)
        own = torch.addcmul(own, down_own[:, None], to_own[None], value=-1)
    total = among[:, :, None].expand(*among.shape[:2], *row.shape[2:])
    for stiffness in force[n:]:
        pivot = stiffness / (1 + stiffness * own[0, 0])
        along, to_own = row[0] * pivot, own[0, 1:] * pivot
        total = torch.addcmul(total, column[:, 0, None], along[None], value=-1)
        row = torch.addcmul(row[1:], own[1:, 0, None], along[None], value=-1)
        column = torch.addcmul(column[:, 1:], column[:, 0, None], to_own[None], value=-1)
        own = torch.addcmul(own[1:, 1:], own[1:, 0, None], to_own[None], value=-1)
    return total


class _AttachedSum(Function):
    """The values in place; the first derivative by the adjoint, further ones from the plain operations."""

    @staticmethod
    def forward(z: Tensor, force: Tensor, rows: Rows, stretches: Sequence[Stretch], at_once: int) -> Tensor:
        return _values(rows, z, force, stretches, at_once)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.save_for_backward(*inputs[:2])
        ctx.rest = inputs[2:]

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        z, force = ctx.saved_tensors
        rows, stretches, at_once = ctx.rest
        again = torch.is_grad_enabled()
        if again or transformed() or torch._C._functorch.is_legacy_batchedtensor(grad):
            # Somebody will differentiate the derivative, or asks for many at once.
            with torch.enable_grad():
                # Views of their own: a force that z moves is no way from z to the sum here.
                own = z.view_as(z), force.view_as(force)
                found = _plain(rows, *own, stretches, at_once)
            wanted = [part for part, needed in zip(own, ctx.needs_input_grad, strict=False) if needed]
            grads = iter(torch.autograd.grad(found, wanted, grad, create_graph=again))
            return *(next(grads) if needed else None for needed in ctx.needs_input_grad[:2]), None, None, None
        of_z, of_force = torch.empty_like(z), torch.empty_like(force)
        for lines, block in _blocks(rows, z, force, stretches, at_once, False):
            own = block.gradient(grad[..., lines].conj_physical().flatten(2))
            of_z[..., lines], of_force[..., lines] = (part.unflatten(-1, (*z.shape[:-1], -1)) for part in own)
        return of_z, of_force, None, None, None


class _Block(NamedTuple):
    """A block of lines of all members, one long row of points, and the arrays that each block writes over."""

    rows: Rows
    stretch: Stretch
    z: Tensor  # [point]
    force: Tensor  # [term, point]
    real: Tensor  # two arrays over modes and points
    feature: Tensor  # [feature, point]
    found: Tensor  # [n_left, n_right, point]

    def features(self) -> Tensor:
        """1 / (λ − z) of near modes, then T_k of the series [feature, point]."""
        _write_features(self.stretch, self.rows.eigenvalue, self.z, self.real, self.feature)
        return self.feature

    def weights(self) -> Tensor:
        """What each feature counts for each pair of rows [pair, feature]."""
        return self.stretch.weights(pairs_of(self.rows.left, self.rows.right)).to(self.real)

    def alone(self, feature: Tensor, weight: Tensor) -> Tensor:
        """G with nothing attached [n_left, n_right, point]."""
        torch.mm(weight, as_real(feature), out=as_real(self.found.flatten(0, 1)))
        return self.found

    def attached(self) -> Tensor:
        """G with all terms attached [n_response, n_reference, point]."""
        return attach_(self.alone(self.features(), self.weights()), self.force)

    def gradient(self, grad: Tensor) -> tuple[Tensor, Tensor]:
        """What the conjugate gradient of `attached` makes the gradients of z and of the terms' D."""
        feature, weight, n_term = self.features(), self.weights(), len(self.force)
        rows = (len(self.found) + len(grad), n_term, len(self.z))
        more, second = (
            _room(name, math.prod(shape), feature.dtype, feature.device).view(shape)
            for name, shape in (("more", rows), ("second", feature.shape))
        )
        of_found, of_force = weights_(self.alone(feature, weight), self.force, grad, more)
        of_feature = as_complex(
            torch.mm(self.stretch.sloped(weight).mT, as_real(of_found.flatten(0, 1)), out=as_real(second))
        )
        of_z = self.stretch.slope(feature, of_feature, self.z)
        return of_z.conj().resolve_conj(), of_force.conj().resolve_conj()


def _write_features(stretch: Stretch, eigenvalue: Tensor, z: Tensor, real: Tensor, feature: Tensor) -> None:
    """1 / (λ − z) of near modes, then T_k of the series.

    Args:
        stretch: that holds z.
        eigenvalue: λ of all modes.
        z: where [*member, point].
        real: two arrays to write over [2, *member, near mode, point].
        feature: takes them [*member, feature, point].
    """
    disc, first, last, series = stretch
    near, slow = feature.split([last - first, feature.shape[-2] - (last - first)], dim=-2)
    apart, scale = real
    # The difference in double precision: beside a pole its digits are all that counts.
    torch.sub(eigenvalue[first:last, None], z.real[..., None, :].contiguous(), out=apart)
    y = z.imag[..., None, :].contiguous().to(apart)
    torch.addcmul(y * y, apart, apart, out=scale).reciprocal_()
    torch.complex(apart.mul_(scale), scale.mul_(y), out=near)
    if series is not None and disc is not None:
        twice = ((z - disc.centre) * (2 / disc.half)).to(slow)
        terms = slow.unbind(-2)
        terms[0].fill_(1)
        torch.mul(twice, 0.5, out=terms[1])
        for before, last_one, following in zip(terms, terms[1:], terms[2:], strict=False):
            torch.mul(twice, last_one, out=following).sub_(before)


def _blocks(
    rows: Rows, z: Tensor, force: Tensor, stretches: Sequence[Stretch], at_once: int, in_single: bool
) -> Iterator[tuple[slice, _Block]]:
    """Lines and what is to be done there, block by block."""
    n_line, n_row, n_column = z.shape[-1], len(rows.left), len(rows.right)
    of_member = z.reshape(-1, n_line)
    of_term = force.reshape(len(force), *of_member.shape)
    sizes = [(s.last - s.first, 0 if s.series is None else s.series.shape[-1]) for s in stretches]
    n_point, real = len(of_member) * min(at_once, n_line), torch.float32 if in_single else z.real.dtype
    kinds = {"real": real, "feature": real.to_complex(), "found": real.to_complex()}
    numbers = 2 * max(near for near, _ in sizes), max(map(sum, sizes)), n_row * n_column
    room = [
        _room(name, number * n_point, dtype, z.device)
        for (name, dtype), number in zip(kinds.items(), numbers, strict=True)
    ]
    for index, ((near, slow), stretch) in enumerate(zip(sizes, stretches, strict=True)):
        lines = slice(index * at_once, min(n_line, (index + 1) * at_once))
        own, tied = of_member[:, lines].flatten(), of_term[..., lines].flatten(1).to(room[1].dtype)
        shapes = (2, near), (near + slow,), (n_row, n_column)
        arrays = [
            part[: torch.Size(shape).numel() * len(own)].view(*shape, len(own))
            for part, shape in zip(room, shapes, strict=True)
        ]
        yield lines, _Block(rows, stretch, own, tied, *arrays)


class _Rooms(threading.local):
    """Arrays that are kept from call to call: to get them anew from the system costs as much as to fill them."""

    def __init__(self) -> None:
        self.arrays: dict[tuple[object, ...], Tensor] = {}


_ROOMS = _Rooms()


def _room(name: str, number: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """An array to write over, one for each name."""
    key = (name, dtype, device)
    found = _ROOMS.arrays.get(key)
    if found is None or len(found) < number or torch.is_inference_mode_enabled():
        found = torch.empty(number, dtype=dtype, device=device)
        if number <= KEPT and not torch.is_inference_mode_enabled():
            _ROOMS.arrays[key] = found
    return found[:number]
