"""Springs, dashpots and masses at places, attached to receptances that are known without them.

With D their dynamic stiffness and G the receptances between them (t), the responses (r) and the references (h),

    H = G_rh − X G_th,    X = G_rt (D⁻¹ + G_tt)⁻¹

(Sherman and Morrison, Annals of Mathematical Statistics 21 (1950) 124; in dynamics the receptance coupling of Bishop
and Johnson, The Mechanics of Vibration, 1960). With Y = (D⁻¹ + G_tt)⁻¹ G_th its derivative is

    dH = dG_rh − X dG_th − dG_rt Y + X dG_tt Y − (X D⁻¹) dD (D⁻¹ Y),

−H dZ H again. For an incoming weight V, A = V Yᵀ is all of Y that is needed: one more row beside each response. What
then stands before the derivative of G belongs to pairs of rows, (Xᵀ, −1) times (A, −V).

Arrays are [n_row, n_column, *batch, n_frequency]: every step is then one operation on long rows of lines.
"""

import functools
from collections.abc import Iterable, Sequence

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.model.receptance.modal_sum import reciprocal


def attach(
    found: Complex[Tensor, "n_left n_right *batch n_frequency"],
    stiffness: Complex[Tensor, "n_term *#batch n_frequency"],
) -> Complex[Tensor, "n_response n_reference *batch n_frequency"]:
    """H: G with terms attached, their rows left out, in operations that may be differentiated in any way.

    Args:
        found: G between the terms, then the responses; and the terms, then the references.
        stiffness: D of each term, in the units of 1 / G.
    """
    n = len(stiffness)
    total = found[n:, n:]
    for pull, felt in zip(pulls(found[:, :n], stiffness), found[:n, n:], strict=True):
        total = torch.addcmul(total, pull[:, None], felt, value=-1)
    return total


def attach_(found: Complex[Tensor, "n_left n_right *point"], stiffness: Complex[Tensor, "n_term *point"]) -> Tensor:
    """The same, written over `found`, in few operations: on short rows each costs more than its numbers."""
    n = len(stiffness)
    total = found[n:, n:]
    for index, pull in enumerate(pulls_(found[:, :n], stiffness)):
        total.addcmul_(pull[:, None], found[index, n:], value=-1)
    return total


def pulls_(
    matrix: Complex[Tensor, "n_row n_term *point"],
    stiffness: Complex[Tensor, "n_term *point"],
    moved: list[Tensor] | None = None,
) -> list[Complex[Tensor, "n_other *point"]]:
    """As `pulls`, written over the matrix, in whose lower rows they are afterwards.

    Args:
        matrix: G_tt, and below it the rows G.
        stiffness: D.
        moved: takes X D⁻¹ of each term, the last one first.
    """
    n = len(stiffness)
    found, inverses, pivots = list(matrix[n:].unbind(1)), [], []
    for index, own in enumerate(stiffness.unbind()):
        yielding = (own * matrix[index, index]).add_(1)
        if moved is None:
            pivots.append(own / yielding)
        else:
            inverses.append(reciprocal(yielding))
            pivots.append(own * inverses[-1])
        if index < n - 1:
            row = matrix[index, index + 1 :] * pivots[-1]
            matrix[index + 1 :, index + 1 :].addcmul_(matrix[index + 1 :, index, None], row, value=-1)
    for index in reversed(range(n)):
        for later in range(index + 1, n):
            found[index].addcmul_(found[later], matrix[index, later], value=-1)
        if moved is not None:
            moved.append(found[index] * inverses[index])
        found[index].mul_(pivots[index])
    return found


def pulls(
    matrix: Complex[Tensor, "n_row n_term *batch n_frequency"],
    stiffness: Complex[Tensor, "n_term *#batch n_frequency"],
) -> list[Complex[Tensor, "n_other *batch n_frequency"]]:
    """X = G (D⁻¹ + G_tt)⁻¹ of each term, for the rows G below those of the terms, G_tt.

    By G_tt's symmetric factors; a term whose D is zero has no force.

    Args:
        matrix: G_tt, and below it the rows G.
        stiffness: D.
    """
    n = len(stiffness)
    found: list[Tensor] = []
    factors: list[Sequence[Tensor]] = []
    for index, own in enumerate(stiffness):
        # Split, not sliced: the backward of a slice fills the rest with zeros.
        column, matrix = matrix.split((1, matrix.shape[1] - 1), dim=1)
        head, column = column.split((1, len(column) - 1))
        row, matrix = matrix.split((1, len(matrix) - 1))
        pivot = own / (1 + own * head[0])
        factor = row * pivot
        factors.append(factor[0].unbind())
        found.append(column[n - 1 - index :, 0] * pivot[0])
        if index < n - 1:
            matrix = torch.addcmul(matrix, column, factor, value=-1)
    for index in reversed(range(n)):
        for later, part in zip(found[index + 1 :], factors[index], strict=True):
            found[index] = torch.addcmul(found[index], later, part, value=-1)
    return found


def weights(
    found: Complex[Tensor, "n_left n_right *batch n_frequency"],
    stiffness: Complex[Tensor, "n_term *#batch n_frequency"],
    incoming: Complex[Tensor, "n_response n_reference *batch n_frequency"],
) -> tuple[Complex[Tensor, "n_left n_right *batch n_frequency"], Complex[Tensor, "n_term *batch n_frequency"]]:
    """What stands before dG and before dD in Σ V dH.

    Args:
        found: G as `attach` takes it.
        stiffness: D.
        incoming: V.
    """
    n, n_response = len(stiffness), len(incoming)
    if not n:
        return incoming, incoming.sum(1)[:0]
    pushed = sum_of(incoming[:, k, None] * found[None, :n, n + k] for k in range(incoming.shape[1]))
    felt = torch.cat([found[n:, :n], pushed])
    pull = pulls(torch.cat([found[:n, :n], felt]), stiffness)
    both, adjoint = torch.stack(pull, dim=1).split(n_response)
    for own, row in zip(pull, found[:n, :n], strict=True):
        # Without D⁻¹, which may be infinite: X D⁻¹ = G_rt − X G_tt.
        felt = torch.addcmul(felt, own[:, None], row, value=-1)
    moved, pushed = felt.split(n_response)
    beside = torch.cat([adjoint, -incoming], dim=1)
    top = sum_of(across[:, None] * along for across, along in zip(both, beside, strict=True))
    return torch.cat([top, -beside]), -(moved * pushed).sum(0)


def weights_(
    found: Complex[Tensor, "n_left n_right n_point"],
    stiffness: Complex[Tensor, "n_term n_point"],
    incoming: Complex[Tensor, "n_response n_reference n_point"],
    room: Complex[Tensor, "n_more n_term n_point"],
) -> tuple[Complex[Tensor, "n_left n_right n_point"], Complex[Tensor, "n_term n_point"]]:
    """As `weights`, written over `found`.

    Args:
        found: G as `attach` takes it.
        stiffness: D.
        incoming: V.
        room: as many rows as `found` has, and one more for each response; written over too.
    """
    n, n_left = len(stiffness), len(found)
    room[:n_left] = found[:, :n]
    pushed = room[n_left:].zero_()
    for k in range(incoming.shape[1]):
        pushed.addcmul_(incoming[:, k, None], found[None, :n, n + k])
    moved: list[Tensor] = []
    pulls_(room, stiffness, moved)
    of_stiffness = torch.empty_like(stiffness)
    for own, both in zip(reversed(of_stiffness.unbind()), moved, strict=True):
        torch.sum(both[: n_left - n] * -both[n_left - n :], 0, out=own)
    torch.neg(room[n_left:], out=found[n:, :n])
    found[n:, n:] = incoming
    found[:n] = 0
    for across, along in zip(room[n:n_left], found[n:], strict=True):
        found[:n].addcmul_(across[:, None], along[None], value=-1)
    return found, of_stiffness


def terms_first(value: Float[Tensor, "*batch n_term"], n_batch: int) -> Float[Tensor, "n_term *more 1"]:
    """Coefficients of terms as `attach` takes them, also where all members of the batch have the same ones."""
    return value.expand(*(1,) * (n_batch + 1 - value.ndim), *value.shape).movedim(-1, 0)[..., None]


def lines_last(
    value: Complex[Tensor, "*batch n_term n_frequency"], n_batch: int
) -> Complex[Tensor, "n_term *more n_frequency"]:
    """Dynamic stiffnesses line by line as `attach` takes them."""
    return value.expand(*(1,) * (n_batch + 2 - value.ndim), *value.shape).movedim(-2, 0)


def sum_of(parts: Iterable[Tensor]) -> Tensor:
    """Their sum, made as they come: an array of all of them would not stay in the cache."""
    return functools.reduce(torch.add, parts)
