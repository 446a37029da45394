"""A virtual hammer test of a model's plate without its mesh error, in the smallest basis that does not show."""

import copy
from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor

from torchplate.measurement.imperfections import PERFECT, Imperfections
from torchplate.measurement.measurement import Measurement
from torchplate.measurement.virtual.analyser import ANALYSERS, Analyser
from torchplate.measurement.virtual.hammer_test import Hammer, hammer_test
from torchplate.model import PlateModel, extrapolate, reduce

# The tested plate may live in a reduced basis only if that cannot be told from the plate itself.
BASIS_TOLERANCE: Final = 1e-6


def simulate(
    model: PlateModel,
    theta: Tensor | Sequence[float] | None = None,
    *,
    response: Sequence[int | Sequence[float]],
    reference: Sequence[int | Sequence[float]],
    analyser: Analyser | str = "sr785",
    hammer: Hammer | None = None,
    kind: str = "accelerance",
    imperfections: Imperfections = PERFECT,
    without_mesh: bool = True,
    seed: int = 0,
) -> Measurement:
    """A virtual hammer test of a plate: what `torchplate simulate` writes.

    Args:
        model: the plate; it stays as it is.
        theta: its searched parameters in SI units, [n_parameter]; left out of a model without intervals.
        response: sensors: node labels or relative places (x, y).
        reference: points that are hit, likewise.
        analyser: its settings, or the name of one of `ANALYSERS`.
        hammer: the hits; left out, half-sines of 1.5 ms and 50 N.
        kind: what the sensors read per force: accelerance, mobility or receptance.
        imperfections: what the test is not perfect in.
        without_mesh: take the error of the mesh off the natural frequencies, so that whoever identifies the plate meets
            the mesh error of a real one.
        seed: of all randomness; the same one gives the same numbers.

    Returns:
        FRFs and coherence on the analyser's lines [Hz].

    Raises:
        ValueError: if theta is missing or a batch, there is no such analyser, or the test cannot be made.
    """
    if theta is None and model.names:
        raise ValueError(
            f"Expected theta, one value in SI units for each of {', '.join(model.names)}, got none: a test needs one "
            "plate. Give theta."
        )
    if isinstance(analyser, str):
        if analyser not in ANALYSERS:
            raise ValueError(f"Expected an analyser of {', '.join(ANALYSERS)}, got '{analyser}'. Name one, or give an "
                             "Analyser.")  # fmt: skip
        analyser = ANALYSERS[analyser]
    place = torch.as_tensor(() if theta is None else theta).detach().to(model.known)
    if place.ndim != 1 or len(place) != len(model.names):
        raise ValueError(
            f"Expected theta of one plate, of length {len(model.names)}, got the shape {tuple(place.shape)}. Test one "
            "member at a time."
        )
    plate = extrapolate(model, float(analyser.frequency.max()), place).model if without_mesh else copy.copy(model)
    plate = _in_reduced_basis(plate, response, reference, analyser, shared=not imperfections.damping_scatter)
    return hammer_test(
        plate,
        place,
        response=response,
        reference=reference,
        analyser=analyser,
        hammer=hammer or Hammer(),
        generator=torch.Generator().manual_seed(seed),
        kind=kind,
        imperfections=imperfections,
    )


def _in_reduced_basis(
    model: PlateModel,
    response: Sequence[int | Sequence[float]],
    reference: Sequence[int | Sequence[float]],
    analyser: Analyser,
    shared: bool = True,
) -> PlateModel:
    """The plate in a basis that holds up to the end of the analyser's anti-alias filter, where there is one.

    Args:
        model: the plate.
        response: sensors.
        reference: points that are hit.
        analyser: whose lines matter.
        shared: whether the basis may be of shared modes, which take one law of damping for all.
    """
    model.response, model.reference, model.kind = response, reference, "receptance"
    # The filter lets through what lies below the sampling rate less the span.
    lines = torch.linspace(1.0, 1.6, 2, dtype=torch.float64)[:, None] * analyser.frequency[1:][None, ::10]
    small = reduce(model, lines.flatten().sort().values.to(model.known), tolerance=BASIS_TOLERANCE)
    if small is None:
        return model
    found, basis = small[0], small[0].assembly.basis
    if found.shared_modes is None or shared:
        return found
    return model if basis is None or basis.shape[0] == basis.shape[1] else model.projected(basis.to(model.known))
