"""Measured modes and the model's that they are paired with, at the same points."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Num
from torch import Tensor

from torchplate.discrepancy import ModalEvidence, comac, mac
from torchplate.measurement import Channel
from torchplate.model import PlateModel


class Shapes(NamedTuple):
    """Measured modes and the model's that they are paired with, at the same points.

    Attributes:
        number: of the model's modes, from 1, rigid-body modes included.
        hertz: measured natural frequencies [Hz].
        measured: deflections.
        model: likewise.
        place: of the points, relative [-].
        label: of the points.
        sides: of the plate [m].
        model_hertz: natural frequencies of the model's [Hz].
        damping_ratio: measured, NaN where it is not known.
    """

    number: tuple[int, ...]
    hertz: tuple[float, ...]
    measured: Num[Tensor, "n_mode n_point"]
    model: Float[Tensor, "n_mode n_point"]
    place: Float[Tensor, "n_point 2"]
    label: tuple[str, ...]
    sides: tuple[float, float]
    model_hertz: tuple[float, ...] = ()
    damping_ratio: tuple[float, ...] = ()

    @property
    def between(self) -> Float[Tensor, "n_mode n_mode"]:
        """MAC of each measured shape, a row, with each of the model's."""
        return mac(self.measured, self.model)

    @property
    def among(self) -> Float[Tensor, "n_mode n_mode"]:
        """AutoMAC: of the measured shapes with each other."""
        return mac(self.measured, self.measured)

    @property
    def by_point(self) -> Float[Tensor, " n_point"]:
        """COMAC of each point."""
        return comac(self.measured, self.model)


@torch.no_grad()
def shapes_of(modal: ModalEvidence, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Shapes:
    """A measured modal model beside the model's modes, in the order of the measured frequencies."""
    paired = modal.to(model.known.device).paired(model, theta)
    order = modal.modal.frequency.cpu().argsort()
    return Shapes(
        tuple((paired.mode.cpu()[order] + 1).tolist()),
        tuple(modal.modal.frequency.cpu()[order].tolist()),
        modal.modal.shape.cpu()[order],
        paired.shape.cpu()[order].to(modal.modal.shape.real.dtype),
        modal.place.cpu(),
        tuple(_label(point) for point in modal.modal.point),
        (model.mesh.length_x, model.mesh.length_y),
        tuple(paired.frequency.cpu()[order].tolist()),
        tuple(modal.modal.damping_ratio.cpu()[order].tolist()),
    )


def _label(point: Channel) -> str:
    """A point's node, or its place [m] where the table names none."""
    if point.node or point.coordinate is None:
        return point.label
    return f"({point.coordinate[0]:.3g}, {point.coordinate[1]:.3g})"
