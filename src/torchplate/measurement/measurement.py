"""What a sensor did read: FRFs by response and reference channel."""

import zipfile
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np
import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.measurement.formats.archive import arrays_of, plain, quoted

Kind = Literal["receptance", "mobility", "accelerance", "transmissibility"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
SI_UNIT: Final[dict[Kind, str]] = {
    "receptance": "m/N",
    "mobility": "m/(N s)",
    "accelerance": "m/(N s²)",
    "transmissibility": "-",
}

LEAST, MOST = 1e-100, 1e100
"""Levels beyond these are no measurement, and their squares no numbers."""
HIGHEST: Final = 1e14
"""No line lies above [Hz]: atoms of a solid vibrate at 1e13 Hz, and nothing above."""


class MeasurementError(ValueError):
    """The user's measurement cannot be used: what was expected, what came, what to do."""


def checked_kind(kind: str, source: str) -> Kind:
    """Check a kind that came from outside: a config, an .npz file.

    Raises:
        MeasurementError: It is none of the four.
    """
    if kind not in KINDS:
        raise MeasurementError(f"{source}: expected a kind out of {', '.join(KINDS)}, got {kind!r}. Name one of these.")
    return kind


@dataclass(frozen=True)
class Channel:
    """One end of an FRF: a node of the test sheet and a direction there.

    Args:
        node: Label on the test sheet, from 1 (0 where the file names none).
        direction: "w", out of the plate along +z; "u", "v" in the plane; "tx", "ty", "tz" rotations.
        coordinate: Place (x, y, z) [m] in the file's frame, or None where the file holds none.
    """

    node: int
    direction: str = "w"
    coordinate: tuple[float, float, float] | None = None

    @property
    def label(self) -> str:
        """Node and direction in one word: "3w"."""
        return f"{self.node}{self.direction}"


@dataclass(frozen=True, eq=False, repr=False)
class Measurement:
    """FRFs H[f, j, k] = response j per unit of reference k at frequency f, time dependence exp(+iωt).

    Args:
        frequency: Frequency lines [Hz], ≥ 0 and rising; the spacing may be uneven.
        frf: [m/N], [m/(N s)], [m/(N s²)] or [-] by `kind`. Entries of pairs that were not measured are set
            to exactly 0, so that sums over channels need no mask; `measured` tells them from a true zero.
        measured: True where the file holds this pair of response and reference.
        response: Sensor channels, in the order of frf's second axis.
        reference: Force channels in the order of frf's last axis; for a transmissibility the moving base.
        kind: "receptance", "mobility", "accelerance" or "transmissibility".
        unit: Unit of the level as text, after any conversion to SI.
        coherence: Ordinary coherence γ², 0 to 1, or None where no pair has one. NaN where a pair has none.
        source: Path or name of where the numbers come from.
        notes: What the reader had to assume or leave out, one sentence each.
        window: Rate of the exponential window over force and responses [1/s], 0 where none is known of; the effect
            `exponential_window` takes it off.

    Raises:
        MeasurementError: Shapes that do not fit, a frequency axis that does not rise, values that are not
            finite at a measured pair, no measured pair at all, an unknown kind.
    """

    frequency: Float[Tensor, " n_frequency"]
    frf: Complex[Tensor, "n_frequency n_response n_reference"]
    measured: Bool[Tensor, "n_response n_reference"]
    response: tuple[Channel, ...]
    reference: tuple[Channel, ...]
    kind: Kind
    unit: str
    coherence: Float[Tensor, "n_frequency n_response n_reference"] | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    window: float = 0.0

    def __post_init__(self) -> None:
        shape = (len(self.frequency), len(self.response), len(self.reference))
        if self.frf.shape != shape or self.measured.shape != shape[1:]:
            raise self._error(
                f"FRFs of shape {shape} (frequency, response, reference) with a `measured` of {shape[1:]}",
                f"{tuple(self.frf.shape)} with {tuple(self.measured.shape)}",
                "Give one FRF column per response and reference channel",
            )
        if self.coherence is not None and self.coherence.shape != shape:
            raise self._error(
                f"a coherence of shape {shape}",
                f"{tuple(self.coherence.shape)}",
                "Give it the shape of the FRFs",
            )
        if shape[0] == 0 or not bool(self.measured.any()):
            raise self._error(
                "at least one measured FRF with one frequency line",
                f"{int(self.measured.sum())} FRFs with {shape[0]} lines",
                "Check which records the file holds, and the band",
            )
        rising = bool((self.frequency.diff() > 0).all()) and bool(torch.isfinite(self.frequency).all())
        if not rising or float(self.frequency[0]) < 0:
            raise self._error(
                "a frequency axis [Hz] that starts at 0 or above and rises from line to line",
                "one that does not",
                "Sort the lines and drop repeated ones",
            )
        if (last := float(self.frequency[-1])) > HIGHEST:
            raise self._error(
                f"a frequency axis [Hz] that ends by {HIGHEST:g} Hz, where nothing vibrates any more",
                f"a line at {last:g} Hz",
                "Correct the axis, or drop that line",
            )
        if self.kind not in KINDS:
            raise self._error(f"a kind out of {', '.join(KINDS)}", f"{self.kind!r}", "Name one of these")
        kept = torch.where(self.measured, self.frf, torch.zeros_like(self.frf))
        sound = kept.abs() < MOST  # which NaN is not
        if not bool(sound.all()):
            bad = (~sound).any(dim=0).nonzero()[0]
            pair = self.pair_label(int(bad[0]), int(bad[1]))
            raise self._error(
                "finite FRFs at every measured pair",
                f"NaN or infinity, or more than {MOST:g}, in {pair}",
                "Restrict the band or drop the pair",
            )
        object.__setattr__(self, "frf", kept)

    def _error(self, expected: str, came: str, action: str) -> MeasurementError:
        return MeasurementError(f"{self.source or 'Measurement'}: expected {expected}, got {came}. {action}.")

    def __repr__(self) -> str:
        """What it holds in a line, and no values: a notebook would print every one of them."""
        shape = f"{len(self.response)} × {len(self.reference)}"
        lines = f"{len(self.frequency)} lines"
        if len(self.frequency):
            lines += f", {float(self.frequency[0]):g} to {float(self.frequency[-1]):g} Hz"
        coherence = ", coherence" if self.coherence is not None else ""
        return (
            f"Measurement({int(self.measured.sum())} of {shape} FRFs, {self.kind} [{self.unit}], "
            f"{lines}{coherence}; {self.source!r})"
        )

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Indices (response, reference) of the measured pairs, response by response."""
        return tuple((int(j), int(k)) for j, k in self.measured.nonzero().tolist())

    @property
    def step(self) -> float | None:
        """Line spacing [Hz] where it is even to 1e-4 of itself (the digits of an ASCII header), else None."""
        if len(self.frequency) < 2:
            return None
        mean = float(self.frequency[-1] - self.frequency[0]) / (len(self.frequency) - 1)
        even = bool(((self.frequency.diff() - mean).abs() <= 1e-4 * mean).all())
        return mean if even else None

    def pair_label(self, response: int, reference: int) -> str:
        """Name of one FRF by its indices, response first: "3w/61w"."""
        return f"{self.response[response].label}/{self.reference[reference].label}"

    def band(self, low: float, high: float) -> "Measurement":
        """Keep the lines with low ≤ frequency ≤ high [Hz].

        Raises:
            MeasurementError: No line lies in the band.
        """
        if low >= high:
            raise self._error("a band from low to high", f"{low:g} to {high:g} Hz", "Swap the ends")
        # Half a millionth of the band's edge: a header's increment has six digits, so that
        # 400 Hz may read 399.9998.
        slack = 5e-7 * max(abs(low), abs(high))
        keep = (self.frequency >= low - slack) & (self.frequency <= high + slack)
        if not bool(keep.any()):
            first, last = float(self.frequency[0]), float(self.frequency[-1])
            raise self._error(
                f"a band that holds lines of the measurement, {first:g} to {last:g} Hz",
                f"{low:g} to {high:g} Hz",
                "Choose measurement.band inside the measured range",
            )
        coherence = None if self.coherence is None else self.coherence[keep]
        return replace(self, frequency=self.frequency[keep], frf=self.frf[keep], coherence=coherence)

    def every(self, step: int) -> "Measurement":
        """Every `step`-th line, the first among them."""
        return self.at_lines(torch.arange(0, len(self.frequency), step))

    def at_lines(self, index: Int[Tensor, " n_kept"]) -> "Measurement":
        """Some of the lines."""
        coherence = None if self.coherence is None else self.coherence[index]
        return replace(self, frequency=self.frequency[index], frf=self.frf[index], coherence=coherence)

    def select(self, keep: Bool[Tensor, "n_response n_reference"]) -> "Measurement":
        """Keep the measured pairs where `keep` is True; channels left without any pair go.

        Raises:
            MeasurementError: No measured pair is left.
        """
        measured = self.measured & keep.to(self.measured.device)
        if not bool(measured.any()):
            raise self._error(
                "a selection that keeps at least one measured pair",
                "one that keeps none",
                "Widen the selection",
            )
        rows, columns = measured.any(dim=1).nonzero()[:, 0], measured.any(dim=0).nonzero()[:, 0]
        coherence = None if self.coherence is None else self.coherence[:, rows][:, :, columns]
        return replace(
            self,
            frf=self.frf[:, rows][:, :, columns],
            measured=measured[rows][:, columns],
            response=tuple(self.response[j] for j in rows.tolist()),
            reference=tuple(self.reference[k] for k in columns.tolist()),
            coherence=coherence,
        )

    def without_zeros(self) -> "Measurement":
        """Leave out the pairs that are zero at every line, as a dead channel leaves them; a note names them.

        So small that its square is no number counts as zero.

        Raises:
            MeasurementError: Every pair is zero at every line.
        """
        alive = (self.frf.abs() > LEAST).any(dim=0)
        dead = [pair for pair in self.pairs if not bool(alive[pair])]
        if not dead:
            return self
        if len(dead) == len(self.pairs):
            raise self._error(
                "an FRF that is not zero at every line",
                f"zeros alone in {self.pair_label(*dead[0])}{' and all others' if len(dead) > 1 else ''}",
                "Check the channels and the band, or export the file again",
            )
        names = ", ".join(self.pair_label(*pair) for pair in dead[:3]) + (" and so on" if len(dead) > 3 else "")
        first, last = float(self.frequency[0]), float(self.frequency[-1])
        note = (
            f"Left out {len(dead)} of {len(self.pairs)} FRFs that are zero at every line from {first:g} to {last:g} Hz "
            f"(a dead channel?): {names}."
        )
        return replace(self.select(alive), notes=(*self.notes, note))

    def to(self, device: torch.device | str) -> "Measurement":
        """Move every tensor to `device`; dtypes stay."""
        return replace(
            self,
            frequency=self.frequency.to(device),
            frf=self.frf.to(device),
            measured=self.measured.to(device),
            coherence=None if self.coherence is None else self.coherence.to(device),
        )

    def to_npz(self, path: Path) -> None:
        """Write every field to a NumPy archive, exactly.

        Keys: frequency, frf, measured, kind, unit, notes, window, coherence (where there is one), and for both ends
        `response` and `reference` (node labels), `response_direction`, `response_coordinate` [m] (NaN where
        there is none), likewise `reference_...`.
        """
        tensors = {"frequency": self.frequency, "frf": self.frf, "measured": self.measured}
        if self.coherence is not None:
            tensors["coherence"] = self.coherence
        arrays: dict[str, Any] = {"window": np.float64(self.window)} | {
            key: value.detach().cpu().numpy() for key, value in tensors.items()
        }
        for end, channels in (("response", self.response), ("reference", self.reference)):
            places = [c.coordinate or (np.nan,) * 3 for c in channels]
            arrays[end] = np.array([c.node for c in channels], dtype=np.int64)
            arrays[f"{end}_direction"] = np.array([c.direction for c in channels], dtype=np.str_)
            arrays[f"{end}_coordinate"] = np.array(places, dtype=np.float64).reshape(-1, 3)
        arrays |= {key: np.array(getattr(self, key), dtype=np.str_) for key in ("kind", "unit", "notes")}
        # Through a handle: given a name without .npz, NumPy would write beside it.
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def from_npz(cls, path: Path, kind: str | None = None) -> "Measurement":
        """Read an archive with the keys of `to_npz`; frequency, frf, response and reference are needed.

        Args:
            path: The .npz file. Its FRFs are in SI units, [n_frequency, n_response, n_reference].
            kind: Overrides the archive's `kind`; needed where it holds none.

        Raises:
            MeasurementError: Not an .npz archive, a missing key, no kind, or arrays that do not fit.
        """
        try:
            arrays = arrays_of(Path(path))
        except (OSError, ValueError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            raise MeasurementError(
                f"{path}: expected a NumPy .npz archive without pickled objects, got a file that does not "
                f"open as one ({quoted(str(error))}). Write it with numpy.savez or Measurement.to_npz."
            ) from error
        missing = [key for key in ("frequency", "frf", "response", "reference") if key not in arrays]
        if missing:
            raise MeasurementError(
                f"{path}: expected the keys frequency, frf, response and reference, got "
                f"{', '.join(sorted(arrays))}. Add {', '.join(missing)}, or name the nodes of FRFs by torchplate frf "
                f"{Path(path).name} --response 3 --reference 28 102 --out FRFS.uff."
            )
        named = kind or (str(arrays["kind"]) if "kind" in arrays else None)
        if named is None:
            raise MeasurementError(
                f"{path}: expected a kind in the archive or in the config, got none. "
                f"Set measurement.kind (--kind of `torchplate new`) to one of {', '.join(KINDS)}."
            )
        checked = checked_kind(named, str(path))
        frf = arrays["frf"].astype(np.complex128)
        if frf.ndim != 3 or arrays["frequency"].ndim != 1:
            raise MeasurementError(
                f"{path}: expected frequency [n_frequency] and frf [n_frequency, n_response, n_reference], "
                f"got {arrays['frequency'].shape} and {frf.shape}. Reshape them before saving."
            )
        if frf.any() and not frf.imag.any() and bool((frf.real[np.isfinite(frf.real)] >= 0).all()):
            raise MeasurementError(
                f"{path}: expected complex FRFs, got amplitudes without a phase in frf. Save the complex values."
            )
        for key in ("frequency", "coherence"):
            if key in arrays and arrays[key].dtype.kind not in "iuf":
                raise MeasurementError(
                    f"{path}: expected real numbers in {key}, got {arrays[key].dtype}. Save it as float64."
                )
        response, reference = _channels(arrays, "response", path), _channels(arrays, "reference", path)
        measured = arrays.get("measured", np.isfinite(frf).any(axis=0)).astype(bool)
        coherence = arrays.get("coherence")
        if coherence is not None and coherence.ndim != 3:
            raise MeasurementError(
                f"{path}: expected coherence of the FRFs' shape {frf.shape}, got {coherence.shape}. Reshape it."
            )
        return cls(
            frequency=torch.from_numpy(arrays["frequency"].astype(np.float64)),
            frf=torch.from_numpy(frf),
            measured=torch.from_numpy(measured),
            response=response,
            reference=reference,
            kind=checked,
            unit=plain(str(arrays["unit"])) if "unit" in arrays and kind is None else SI_UNIT[checked],
            coherence=None if coherence is None else torch.from_numpy(coherence.astype(np.float64)),
            source=str(path),
            notes=tuple(plain(str(note)) for note in arrays.get("notes", np.array([], dtype=np.str_))),
            window=_rate(arrays["window"], path) if "window" in arrays else 0.0,
        )


def _rate(given: np.ndarray, path: Path) -> float:
    if given.size != 1 or given.dtype.kind not in "iuf" or not 0 <= float(given.reshape(-1)[0]) < MOST:
        raise MeasurementError(f"{path}: expected the rate of a window in 1/s, got {given!r:.80}. Leave `window` out.")
    return float(given.reshape(-1)[0])


def _channels(arrays: dict[str, np.ndarray], end: str, path: Path) -> tuple[Channel, ...]:
    nodes = arrays[end].reshape(-1)
    directions = arrays.get(f"{end}_direction", np.full(len(nodes), "w"))
    places = arrays.get(f"{end}_coordinate", np.full((len(nodes), 3), np.nan))
    if nodes.dtype.kind not in "iuf" or places.dtype.kind not in "iuf":
        raise MeasurementError(
            f"{path}: expected real numbers in {end} and {end}_coordinate, got {nodes.dtype} and {places.dtype}. "
            "Give node labels and metres."
        )
    if directions.shape != nodes.shape or places.shape != (len(nodes), 3):
        raise MeasurementError(
            f"{path}: expected {end}_direction of {len(nodes)} and {end}_coordinate of ({len(nodes)}, 3) "
            f"entries, one per {end}, got {directions.shape} and {places.shape}. Give each channel its own."
        )
    rows = zip(nodes.tolist(), directions.tolist(), places.tolist(), strict=True)
    return tuple(
        Channel(int(node), plain(str(direction)), None if np.isnan(place).any() else (place[0], place[1], place[2]))
        for node, direction, place in rows
    )
