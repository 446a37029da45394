"""A modal model estimated from FRFs: poles by the least-squares complex frequency method, shapes by its residues.

sdypy-EMA fits polynomials of rising order with one denominator for all FRFs (LSCF); its roots are poles. Those that
come back order after order are modes; a linear fit with the poles held (LSFD) gives the residue of each FRF. Source:
Guillaume, Verboven, Vanlanduit, Van der Auweraer and Peeters, "A poly-reference implementation of the least-squares
complex frequency-domain estimator", IMAC XXI (2003).
"""

import importlib
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import torch
from jaxtyping import Complex, Float

from torchplate.measurement.measurement import Measurement, MeasurementError
from torchplate.measurement.modal.model import ModalModel

MISSING: Final = (
    "modes: expected the package sdypy-EMA, which estimates poles, found none. Run pip install 'torchplate-fem[modal]'."
)
SAME_FREQUENCY, SAME_DAMPING = 2e-3, 0.1
"""Poles of two orders are one where they agree so far, relative: the usual limits are 1 % and 5 to 10 %."""
LEAST_ORDERS: Final = 0.2
"""Part of the orders in which a mode comes back: the peaks of a lightly damped strip come back in a fifth to a half."""
MOST_DAMPED: Final = 0.2
"""Damping ratio beyond which a pole is no resonance [-]."""
NORMAL: Final = 0.99
"""Modal phase collinearity of all modes beyond which the shapes are taken as real; 0.95 is the usual limit of one."""
WEAK: Final = 1e-3
"""A mode whose peaks are below this part of the strongest mode's is none."""


@dataclass(frozen=True, eq=False)
class Analysed:
    """What an estimate of modes gives.

    Args:
        model: The modes, in the order of their frequencies, with real shapes where all are normal modes.
        indicator: Mode indicator function at each natural frequency [-]: 1 where all FRFs are in quadrature with the
            force, as at a normal mode (Breitkopf, IMAC III, 1985).
        collinearity: Modal phase collinearity [-]: 1 where all points move in phase or against it (Pappa, Elliott and
            Schenk, J. Guidance 16, 1993, 440).
        orders: Part of the polynomial orders in which each mode came back [-].
    """

    model: ModalModel
    indicator: Float[np.ndarray, " n_mode"]
    collinearity: Float[np.ndarray, " n_mode"]
    orders: Float[np.ndarray, " n_mode"]


def modes(
    measurement: Measurement, lowest: float | None = None, highest: float | None = None, order: int = 40
) -> Analysed:
    """Estimate natural frequencies, damping and mode shapes from FRFs.

    The shapes are those of the responses or of the references, whichever are more. Two modes closer than their width
    come out as one: all FRFs have one denominator.

    Args:
        measurement: FRFs on even lines.
        lowest: End of the band [Hz]; that of the measurement if left out.
        highest: The other end [Hz].
        order: Modes at most that the polynomials can hold, half their degree.

    Raises:
        MeasurementError: What is given holds no FRFs, the package sdypy-EMA is not there, the lines are not even, the
            band holds too few of them, or no mode comes back.
    """
    if not isinstance(measurement, Measurement):
        raise MeasurementError(
            f"modes: expected measured FRFs, a Measurement, got {type(measurement).__name__}. Read them by "
            "tp.read_measurement(FILE); the modes of a model are model.modes(theta)."
        )
    ema = _package()
    source = measurement.source or "Measurement"
    frequency = measurement.frequency.cpu().numpy()
    low = max(float(frequency[0]) if lowest is None else lowest, 0.0)
    high = float(frequency[-1]) if highest is None else highest
    if not low < high:
        raise MeasurementError(f"{source}: expected a band that rises, got {low:g} to {high:g} Hz. Correct it.")
    inside = (frequency >= low) & (frequency <= high) & (frequency > 0)
    if int(inside.sum()) < 4 * order:
        # Each order adds two unknown numbers; so few lines leave none over to tell poles from noise.
        order = int(inside.sum()) // 4
    if order < 4:
        raise MeasurementError(
            f"{source}: expected 16 lines at least between {low:g} and {high:g} Hz, got {int(inside.sum())}. Widen "
            "--lowest and --highest, or measure with finer lines."
        )
    step = measurement.step
    offset = 1.0 if step is None else float(frequency[0]) / step % 1.0
    if step is None or min(offset, 1 - offset) > 0.01:
        raise MeasurementError(
            f"{source}: expected evenly spaced lines, multiples of their step, got others. Export the FRFs as the "
            "analyser made them, or estimate them again by `torchplate frf`."
        )
    pairs = measurement.pairs
    frf = np.stack([measurement.frf[:, j, k].cpu().numpy() for j, k in pairs])
    # A motion over the base's has the poles and residuals of an accelerance.
    form = "accelerance" if measurement.kind == "transmissibility" else measurement.kind
    kept = frequency <= high
    model = ema.Model(
        frf[:, kept], frequency[kept], lower=float(frequency[inside][0]), upper=float(frequency[kept][-1]),
        pol_order_high=order, frf_form=form,
    )  # fmt: skip
    try:
        model.get_poles(method="lscf", show_progress=False)
    except np.linalg.LinAlgError:
        raise MeasurementError(
            f"{source}: expected FRFs whose poles can be fitted between {low:g} and {high:g} Hz, got a singular fit. "
            "Choose another band by --lowest and --highest."
        ) from None
    found = _stable(model, low, high)
    if found:
        model.pole_ind = [one[2] for one in found]
        # The package leaves out the last line.
        residue = np.asarray(model.get_constants(f_upper=float(model.freq[-1]))[1])[:, : len(found)]
        hertz, ratio = np.array([one[0] for one in found]), np.array([one[1] for one in found])
        # |H| at a resonance is |A| / (ζω), whatever the kind.
        peak = np.linalg.norm(residue, axis=0) / (ratio * hertz)
        if form != "receptance":
            peak = peak * hertz ** (1 if form == "mobility" else 2)
        strong = peak > WEAK * peak.max()
        found = [one for one, good in zip(found, strong, strict=True) if good]
        residue = residue[:, strong]
    if not found:
        raise MeasurementError(
            f"{source}: expected modes between {low:g} and {high:g} Hz, got no pole that comes back order after order. "
            "Look at the FRFs by `torchplate inspect`, or choose another band."
        )
    return _analysed(measurement, found, residue, order, source)


def _package() -> Any:
    try:
        return importlib.import_module("sdypy.EMA")
    except ImportError:
        raise MeasurementError(MISSING) from None


def _stable(model: Any, low: float, high: float) -> list[tuple[float, float, tuple[int, int], int]]:
    """Modes that come back: frequency, damping ratio, order and index of the pole that stands for them, orders.

    A pole is stable where the order before has it, too; stable poles of all orders whose frequencies follow each other
    closely are one mode.
    """
    stable: list[tuple[float, float, int, int]] = []
    before = np.empty((0, 2))
    for turn, (hertzs, ratios) in enumerate(zip(model.pole_freq, model.pole_xi, strict=True)):
        good = (hertzs >= low) & (hertzs <= high) & (hertzs > 0) & (ratios > 0) & (ratios < MOST_DAMPED)
        own = np.flatnonzero(good)
        for index in own:
            off = np.abs(before / np.array([hertzs[index], ratios[index]]) - 1)
            if ((off[:, 0] < SAME_FREQUENCY) & (off[:, 1] < SAME_DAMPING)).any():
                stable.append((float(hertzs[index]), float(ratios[index]), turn, int(index)))
        before = np.stack([hertzs[own], ratios[own]], axis=-1)
    stable.sort()
    gaps = [b[0] > a[0] * (1 + SAME_FREQUENCY) for a, b in pairwise(stable)]
    edges = [0, *(place for place, gap in enumerate(gaps, start=1) if gap), len(stable)]
    found = []
    for first, last in pairwise(edges):
        group = stable[first:last]
        n_order = len({one[2] for one in group})
        if n_order < LEAST_ORDERS * len(model.pole_freq):
            continue
        middle = np.median([one[:2] for one in group], axis=0)
        best = min(group, key=lambda one: abs(one[0] / middle[0] - 1) + 0.1 * abs(one[1] / middle[1] - 1))
        found.append((float(middle[0]), float(middle[1]), (best[2], best[3]), n_order))
    return found


def _analysed(
    measurement: Measurement,
    found: list[tuple[float, float, tuple[int, int], int]],
    residue: Complex[np.ndarray, "n_pair n_mode"],
    order: int,
    source: str,
) -> Analysed:
    notes: list[str] = []
    table = np.full((len(measurement.response), len(measurement.reference), len(found)), np.nan, dtype=np.complex128)
    for (j, k), row in zip(measurement.pairs, residue, strict=True):
        table[j, k] = row
    points, by_response = measurement.response, True
    if len(measurement.reference) > len(points) and measurement.kind != "transmissibility":
        table, points, by_response = table.swapaxes(0, 1), measurement.reference, False
    there = np.isfinite(table[..., 0])
    rows = there[:, int(there.sum(0).argmax())]
    columns = there[rows].all(0)
    if not rows.all():
        notes.append(
            f"Left out {int((~rows).sum())} points of the shapes, whose FRFs lack the reference of the others."
        )
    vector, _, _ = np.linalg.svd(np.moveaxis(table[rows][:, columns], -1, 0), full_matrices=False)
    shape = np.stack([_turned(one[:, 0]) for one in vector])
    points = tuple(channel for channel, kept in zip(points, rows, strict=True) if kept)
    if len(points) < 3:
        notes.append(
            f"The shapes are known at {len(points)} point{'s' * (len(points) > 1)} only, from which the MAC tells "
            "nothing; the frequencies and damping stand."
        )
    collinear = np.array([_collinearity(one) for one in shape])
    real = bool((collinear > NORMAL).all())
    model = ModalModel(
        torch.tensor([one[0] for one in found], dtype=torch.float64),
        torch.tensor([one[1] for one in found], dtype=torch.float64),
        torch.from_numpy(shape.real.copy() if real else shape),
        points,
        source=source,
        notes=(*notes, f"Shapes at the {'responses' if by_response else 'references, by reciprocity'}."),
    )
    indicator = np.array([_indicator(measurement, one[0]) for one in found])
    return Analysed(model, indicator, collinear, np.array([one[3] for one in found]) / order)


def _turned(shape: Complex[np.ndarray, " n_point"]) -> Complex[np.ndarray, " n_point"]:
    """With most of it real, and the largest deflection 1."""
    turned = shape * np.exp(-0.5j * np.angle((shape**2).sum()))
    return turned / turned.real[np.abs(turned.real).argmax()]


def _collinearity(shape: Complex[np.ndarray, " n_point"]) -> float:
    """((λ1 − λ2) / (λ1 + λ2))² of the two eigenvalues of the products of real and imaginary part."""
    parts = np.stack([shape.real, shape.imag])
    small, large = np.linalg.eigvalsh(parts @ parts.T)
    return float(((large - small) / (large + small)) ** 2)


def _indicator(measurement: Measurement, hertz: float) -> float:
    """1 − Σ |Re H| |H| / Σ |H|² at the nearest line; of a mobility the imaginary part."""
    line = int((measurement.frequency - hertz).abs().argmin())
    frf = measurement.frf[line].cpu().numpy()
    level = np.abs(frf)
    other = np.abs(frf.imag if measurement.kind == "mobility" else frf.real)
    return float(1 - (other * level).sum() / max((level**2).sum(), np.finfo(float).tiny))
