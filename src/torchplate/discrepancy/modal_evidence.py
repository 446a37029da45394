"""The gap between a measured modal model and the modes of the plate's model, paired by their shapes.

A measured mode r and the model's mode that is paired with it deviate by

    (f_model − f_r) / f_r    and    e = (φ_r − a φ_model) / ‖φ_r‖,  a = φ_modelᴴφ_r / ‖φ_model‖²,

and ‖e‖² = 1 − MAC exactly: e is what is left of the shape once the model's is scaled to fit. Each counts by one over
its standard deviation. Source: Friswell and Mottershead, Finite Element Model Updating in Structural Dynamics (1995).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchplate.discrepancy.assurance import mac
from torchplate.measurement import SCATTER, ModalModel, NaturalFrequencies, place_points
from torchplate.model import DENSE, ModesAt, PlateModel, SparseModel, modes_at
from torchplate.notation import percent

SHAPE_STD: Final = 0.1
"""√(1 − MAC) that the noise of careful shapes leaves [-]: a MAC of 0.99."""
APART: Final = 0.5
"""What a factor e between two frequencies takes off their MAC when modes are paired: few points make far modes alike.
"""
MARGIN: Final = 1.5
"""Modes of the model up to so many times the highest measured frequency are looked at."""


CLUSTER: Final = 0.02
"""Modes of the model closer than this, relative, are a cluster: what a plate lacks moves one so far beside another."""


MOST_IN_CLUSTER: Final = 8
"""Longer chains of modes are no cluster: high modes of a plate lie densely, and all would be in one."""


class Paired(NamedTuple):
    """The model's modes beside the measured ones.

    Attributes:
        mode: index of the model's mode, from 0, rigid-body modes included.
        frequency: its natural frequency [Hz].
        shape: its deflections at the points.
    """

    mode: Int[Tensor, "*batch n_mode"]
    frequency: Float[Tensor, "*batch n_mode"]
    shape: Float[Tensor, "*batch n_mode n_point"]


class ModePair(NamedTuple):
    """One measured mode beside the model's, for people.

    Attributes:
        mode: number of the model's mode, from 1, rigid-body modes included.
        measured: natural frequency [Hz].
        model: likewise.
        mac: of the two shapes.
    """

    mode: int
    measured: float
    model: float
    mac: float


@dataclass(frozen=True, eq=False)
class ModalEvidence:
    """A modal model on a plate, and how well it is known.

    Args:
        modal: what was measured.
        place: relative places of its points [-].
        n_mode: modes of the plate's model that are looked at.
        frequency_std: standard deviation of the frequencies, relative [-], > 0; None: `SCATTER` is taken.
        shape_std: standard deviation of the shapes, √(1 − MAC) [-], > 0; None: `SHAPE_STD` is taken.
        remark: how the points were matched to the plate.
    """

    modal: ModalModel
    place: Float[Tensor, "n_point 2"]
    n_mode: int
    frequency_std: float | None = None
    shape_std: float | None = None
    remark: str = ""

    def __post_init__(self) -> None:
        for name in ("frequency_std", "shape_std"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"Expected a {name} above 0, got {value}. Leave it out where it is not known.")

    @classmethod
    def of(
        cls,
        model: PlateModel,
        modal: ModalModel,
        frequency_std: float | None = None,
        shape_std: float | None = None,
    ) -> "ModalEvidence":
        """Match the points to a plate, and count the modes to look at.

        Raises:
            MeasurementError: A point is not on the plate.
            ValueError: A standard deviation that is not positive, more modes than the mesh has.
        """
        mesh = model.mesh
        placement = place_points(modal.point, modal.source, mesh.length_x, mesh.length_y, mesh.n_x, mesh.n_y)
        n_measured, size = len(modal.frequency), model.assembly.size
        if n_measured > size:
            raise ValueError(
                f"Expected {size} modes at most, as many as the mesh has, got {n_measured}. Raise mesh.refine."
            )
        top, counts = MARGIN * float(modal.frequency.max()), [n_measured + 6]
        for part in (0.0, 0.5, 1.0) if model.names else (0.5,):
            theta = model.space.to_si(torch.full_like(model.space.low, part))
            found = SparseModel(model, theta).modes(1, top, dense=size <= DENSE).frequency
            counts.append(int((found <= top).sum()))
        return cls(modal, placement.response_place, min(size, max(counts)), frequency_std, shape_std, placement.remark)

    def to(self, device: torch.device | str) -> "ModalEvidence":
        """Move every tensor to `device`."""
        return replace(self, modal=self.modal.to(device), place=self.place.to(device))

    @property
    def scale(self) -> float:
        """What a shape's residual counts beside a frequency's: the ratio of their standard deviations [-]."""
        return (self.frequency_std or SCATTER) / (self.shape_std or SHAPE_STD)

    def paired(self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"]) -> Paired:
        """The model's mode for each measured one, each at most once: the greatest MAC first.

        Between shapes that are as much alike the nearer frequency decides; see `APART`.
        """
        modes = modes_at(model, theta, self.place, self.n_mode)
        score = self.score(modes)
        index = torch.zeros(score.shape[:-1], dtype=torch.int64, device=score.device)
        own, theirs = (torch.arange(n, device=score.device) for n in score.shape[-2:])
        for _ in range(score.shape[-2]):
            best = score.flatten(-2).argmax(-1)
            row, column = best // score.shape[-1], best % score.shape[-1]
            here = own == row[..., None]
            index = torch.where(here, column[..., None], index)
            taken = here[..., :, None] | (theirs == column[..., None])[..., None, :]
            score = torch.where(taken, -torch.inf, score)
        shape = modes.shape.gather(-2, index[..., None].expand(*index.shape, modes.shape.shape[-1]))
        return Paired(index, modes.frequency.gather(-1, index), shape)

    def score(self, modes: ModesAt) -> Float[Tensor, "*batch n_mode n_candidate"]:
        """MAC less `APART` |ln(f_model / f_measured)| of each pair."""
        frequency = modes.frequency.detach().clamp(min=1e-6)
        apart = (frequency[..., None, :] / self.modal.frequency[:, None].to(frequency)).log().abs()
        shape = self.modal.shape.to(torch.promote_types(self.modal.shape.dtype, modes.shape.dtype))
        return mac(shape, modes.shape.detach()) - APART * apart

    def residual(self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n"]:
        """Relative deviations of the frequencies, then of the shapes, point by point, times `scale`."""
        paired = self.paired(model, theta)
        frequency = paired.frequency / self.modal.frequency.to(paired.frequency) - 1
        measured = self.modal.shape.to(torch.promote_types(self.modal.shape.dtype, paired.shape.dtype))
        measured = measured / measured.abs().square().sum(-1, keepdim=True).sqrt()
        energy = paired.shape.square().sum(-1, keepdim=True)
        factor = (paired.shape * measured).sum(-1, keepdim=True) / energy.clamp(min=1e-300)
        left = self.scale * (measured - factor * paired.shape)
        parts = [left.real, left.imag] if left.is_complex() else [left]
        return torch.cat([frequency, *(part.flatten(-2) for part in parts)], dim=-1)

    def error(self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """√(mean over modes of ((f_model − f) / f)² + scale² (1 − MAC)) [-]."""
        return (self.residual(model, theta).square().sum(-1) / len(self.modal.frequency)).sqrt()

    def frequency_error(self, model: PlateModel, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """√(mean over modes of ((f_model − f) / f)²) of the paired modes [-]."""
        frequency = self.paired(model, theta).frequency
        return (frequency / self.modal.frequency.to(frequency) - 1).square().mean(-1).sqrt()

    def variance(self) -> tuple[Float[Tensor, " n"], Int[Tensor, " n"]]:
        """Of each residual, NaN where no standard deviation was told; and 0 for a frequency, 1 for a shape."""
        n_mode, n_point = self.modal.shape.shape
        n_part = n_mode * n_point * (2 if self.modal.is_complex else 1)
        group = torch.cat([torch.zeros(n_mode, dtype=torch.int64), torch.ones(n_part, dtype=torch.int64)])
        of_frequency = math.nan if self.frequency_std is None else self.frequency_std**2
        # The variance of a shape is spread evenly over its points.
        of_shape = math.nan if self.shape_std is None else (self.scale * self.shape_std) ** 2 * n_mode / n_part
        value = torch.where(group == 0, of_frequency, of_shape).to(torch.float64)
        return value.to(self.modal.frequency), group.to(self.modal.frequency.device)

    @torch.no_grad()
    def pairs(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> list[ModePair]:
        """The measured modes in their order, each beside the model's."""
        found = self.paired(model, theta)
        shape = self.modal.shape.to(torch.promote_types(self.modal.shape.dtype, found.shape.dtype))
        alike = mac(shape, found.shape).diagonal()
        columns = (found.mode + 1, self.modal.frequency, found.frequency, alike)
        return [ModePair(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]

    @torch.no_grad()
    def table(self, model: PlateModel, say: Callable[[str], object] = lambda _: None) -> NaturalFrequencies:
        """The frequencies by the numbers of the model's modes, in the middle of its intervals.

        Frequencies of a model rise with the number, so pairs that come in the other order are given their numbers by
        frequency. Modes within `CLUSTER` of each other change places at the least change of the plate: where some of
        them were measured and some were not, nobody knows which, and they are left out unless nothing else is there.
        Both are said.

        Args:
            model: of the plate.
            say: is told the numbers.
        """
        middle = model.space.to_si(torch.full_like(model.space.low, 0.5))
        pairs = sorted(self.pairs(model, middle), key=lambda pair: pair.measured)
        numbers = sorted(pair.mode for pair in pairs)
        swapped = [pair.measured for pair, number in zip(pairs, numbers, strict=True) if pair.mode != number]
        doubtful = _doubtful(numbers, modes_at(model, middle, self.place, self.n_mode).frequency.tolist())
        if len(doubtful) == len(numbers):
            doubtful = set()
        values = {m: pair.measured for m, pair in zip(numbers, pairs, strict=True) if m not in doubtful}
        least = min(pairs, key=lambda pair: pair.mac)
        listed = ", ".join(f"{number}: {hertz:.5g} Hz" for number, hertz in values.items())
        text = f"The modal model counts by its frequencies, paired by MAC with the model's modes {listed}"
        text += f" (least MAC {least.mac:.2f}, at {least.measured:.5g} Hz)"
        if swapped:
            text += f"; at {_listed(swapped)} Hz the shapes have changed places, and the frequency numbers them"
        if doubtful:
            out = [pair.measured for number, pair in zip(numbers, pairs, strict=True) if number in doubtful]
            text += f"; left out {_listed(out)} Hz, where the model has more modes close by than were measured"
        say(f"{text}.")
        spread = None if self.frequency_std is None else {m: self.frequency_std * f for m, f in values.items()}
        return NaturalFrequencies.from_mapping(values, spread)

    @property
    def assumed(self) -> str:
        """What is assumed of the scatter, in one sentence; empty where both standard deviations are told."""
        parts = []
        if self.frequency_std is None:
            parts.append(f"a standard deviation of {percent(SCATTER)} of the frequencies")
        if self.shape_std is None:
            parts.append(f"one of {SHAPE_STD:g} of the shapes, a MAC of {1 - SHAPE_STD**2:g},")
        if not parts:
            return ""
        return (
            f"The modal model tells no scatter: {' and '.join(parts)} is assumed. Give modal_model.frequency_std and "
            "modal_model.shape_std where you know better."
        )


def _listed(hertzs: list[float]) -> str:
    return ", ".join(f"{hertz:.5g}" for hertz in hertzs)


def _doubtful(numbers: list[int], hertzs: list[float]) -> set[int]:
    """The numbers, from 1, in clusters of the model's frequencies [Hz] of which not all modes were measured."""
    far = [b > a * (1 + CLUSTER) for a, b in pairwise(hertzs)]
    edges = [0, *(place for place, apart in enumerate(far, start=1) if apart), len(hertzs)]
    found: set[int] = set()
    for first, last in pairwise(edges):
        held = {number for number in numbers if first < number <= last}
        if len(held) < last - first <= MOST_IN_CLUSTER:
            found |= held
    return found
