"""What it does to FRFs that sensors, hits and supports are off their marks.

That a sensor reads and a hit strikes elsewhere is a row of the mesh's slopes, which `nuisance` takes. Here is what
moves with a sensor, what holds the plate elsewhere, and what the second order adds.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy.modal_change import Modal, from_responses, sum_of_modes, to_references
from torchplate.discrepancy.specimen import Found, where_read
from torchplate.effects import SensorChain, SupportSpring
from torchplate.model import PlateModel, support_marks


def places_again(
    model: PlateModel,
    modal: Modal,
    response: Tensor,
    reference: Tensor | None,
    off: list[float],
    about: Found | None,
) -> Float[Tensor, "n_frequency n_response n_reference"]:
    """Mean square of what the second order of places adds to receptances: curvatures, twist, and both ends at once.

    E ν⁴ = 3 for a curvature ½ w,xx ν², E ν²μ² = 1 for products of two. Of places that were found, what is left of ν.
    """
    left = (None, None) if about is None or about.channels is None else about.channels.places_left()
    if left[0] is not None:
        left = where_read(model, left[0], left[1])

    def rows(place: Tensor, of_side: Tensor | None, order: tuple[int, int]) -> Tensor:
        size = off[0] ** order[0] * off[1] ** order[1]
        found = size * model.assembly.rows(model.mesh.deflection_at(place, *order)) @ modal.shape
        return found if of_side is None else (of_side ** torch.tensor(order)).prod(-1, keepdim=True) * found

    total = torch.zeros(len(modal.denominator), len(modal.left), len(modal.right)).to(modal.left)
    if not any(off):
        return total
    for order, weight in (((2, 0), 0.75), ((0, 2), 0.75), ((1, 1), 1.0)):
        total = total + weight * sum_of_modes(modal, rows(response, left[0], order), modal.right).abs().square()
        if reference is not None:
            there = rows(reference, left[1], order)
            total = total + weight * sum_of_modes(modal, modal.left, there).abs().square()
    if reference is not None:
        for along in ((1, 0), (0, 1)):
            here = rows(response, left[0], along)
            for across in ((1, 0), (0, 1)):
                total = total + sum_of_modes(modal, here, rows(reference, left[1], across)).abs().square()
    return total


def carried_off(
    model: PlateModel, modal: Modal, chain: SensorChain, theta: Tensor
) -> dict[int, dict[tuple[int, int], Tensor]]:
    """What it does to receptances that the mass of a sensor moves with it, by sensor, for a side along each axis."""
    found: dict[int, dict[tuple[int, int], Tensor]] = {}
    value = model.values(theta)
    if model.off_marks is not None:
        value = model.off_marks.moved(value)
    for label, index in model.carried().items():
        place = torch.stack([value[label][axis] for axis in ("x", "y")])[None].to(modal.left)
        inertia = value[label]["mass"] * chain.laplace.square()
        row = model.assembly.rows(model.mesh.deflection_at(place)) @ modal.shape
        left, right = from_responses(modal, row), to_references(modal, row)
        own = found.setdefault(index, {})
        for order in ((1, 0), (0, 1)):
            moved = model.assembly.rows(model.mesh.deflection_at(place, *order)) @ modal.shape
            outer = left * to_references(modal, moved) + from_responses(modal, moved) * right
            own[order] = own.get(order, torch.zeros_like(outer)) - inertia[:, None, None] * outer
    return found


def supports_off(
    model: PlateModel, modal: Modal, laplace: Tensor, off: tuple[float, float], theta: Tensor
) -> list[Tensor]:
    """What it does that each support sits off its mark, along one side and along the other, relative to these."""
    values, mesh = model.values(theta), model.mesh
    place = support_marks(mesh, model.effects).to(modal.left)
    moved = None if model.off_marks is None else model.off_marks.support
    if moved is not None:
        place[: len(moved)] += moved[: len(place)].to(place)
    strength: list[Tensor] = []
    for label, effect in model.effects.items():
        if isinstance(effect, SupportSpring):
            one = modal.kappa[:, 0] * values[label]["stiffness"] + laplace * values[label]["viscous_damping"]
            strength += [one] * len(effect.points)
    rows = model.assembly.rows(mesh.deflection_at(place)) @ modal.shape
    left, right = from_responses(modal, rows), to_references(modal, rows)
    found: list[tuple[Tensor, ...]] = []
    for side, order in zip(off, ((1, 0), (0, 1)), strict=True):
        slope = side * model.assembly.rows(mesh.deflection_at(place, *order)) @ modal.shape
        left_moved, right_moved = from_responses(modal, slope), to_references(modal, slope)
        found.append(
            tuple(
                -one[:, None, None]
                * (left[:, :, k, None] * right_moved[:, None, k] + left_moved[:, :, k, None] * right[:, None, k])
                for k, one in enumerate(strength)
            )
        )
    return [one for pair in zip(*found, strict=True) for one in pair]
