"""Modal models in universal files: datasets 55 and 2414 read, 55 written, with nodes (15, 2411) and units (164).

Source: Universal File Format, University of Cincinnati SDRL, datasets 55 and 2414. pyuff reads them.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch

from torchplate.measurement.measurement import Channel, MeasurementError
from torchplate.measurement.modal.model import ModalModel
from torchplate.measurement.uff.dataset import UffFile, open_uff
from torchplate.measurement.uff.geometry import geometry_of
from torchplate.measurement.uff.writer import block, nodes_block, units_block

NORMAL, COMPLEX = 2, (3, 7)
"""Analysis types: a normal mode; a complex mode of the first and of the second order."""
RIGID: Final = 1e-4
"""A mode below this part of the highest frequency is one of the rigid-body modes that finite-element programs write."""
# What the format may count of a node: three translations, or three rotations beside them.
N_DIRECTION = (3, 6)


class _Mode(NamedTuple):
    frequency: float
    damping_ratio: float
    shape: dict[int, complex]
    is_complex: bool


class _Out(NamedTuple):
    """Which way is out of the plate: the file's axis, and the directions of nodes that have their own."""

    normal: int
    turned: dict[int, np.ndarray]


def read_modal_uff(path: Path, normal: int = 3) -> ModalModel:
    """Read the modes of a universal file, out of the plate.

    Args:
        path: The file.
        normal: The file's axis that points out of the plate, 1 to 3.

    Raises:
        MeasurementError: Not a universal file, or no mode with a frequency and a shape in it.
    """
    file = open_uff(path)
    geometry = geometry_of(file)
    out = _Out(normal, geometry.turned)
    modes, others = [], 0
    for index, kind in enumerate(file.types):
        if kind in (55, 2414):
            found = _mode(file, index, kind, out, path)
            modes += [] if found is None else [found]
            others += found is None
    if not modes:
        held = ", ".join(str(kind) for kind in sorted(set(file.types)))
        action = (
            f"Estimate them by `torchplate modes {path.name} --out MODES.uff`"
            if 58 in file.types
            else "Export the modes from the modal analysis"
        )
        raise MeasurementError(
            f"{path}: expected mode shapes (dataset 55 or 2414, analysis type 2, 3 or 7), got datasets {held}"
            f"{' of other kinds' if others else ''}. {action}."
        )
    notes = list(geometry.notes)
    if others:
        notes.append(f"Left out {others} of datasets 55 and 2414 that hold no mode.")
    top = max(mode.frequency for mode in modes)
    bending = [mode for mode in modes if mode.frequency > RIGID * top]
    if n_rigid := len(modes) - len(bending):
        notes.append(f"Left out {n_rigid} mode{'s' * (n_rigid > 1)} at 0 Hz: rigid-body modes.")
    if not bending:
        raise MeasurementError(
            f"{path}: expected modes with a natural frequency, got {n_rigid} at 0 Hz. Export them with their "
            "frequencies or eigenvalues."
        )
    nodes = _common(bending, notes)
    shape = np.array([[mode.shape[node] for node in nodes] for mode in bending]).reshape(len(bending), len(nodes))
    is_complex = any(mode.is_complex for mode in bending)
    return ModalModel(
        torch.tensor([mode.frequency for mode in bending], dtype=torch.float64),
        torch.tensor([mode.damping_ratio for mode in bending], dtype=torch.float64),
        torch.from_numpy(shape if is_complex else shape.real.copy()),
        tuple(Channel(node, "w", geometry.places.get(node)) for node in nodes),
        source=str(path),
        notes=tuple(notes),
    )


def _mode(file: UffFile, index: int, kind: int, out: _Out, path: Path) -> _Mode | None:
    """One dataset; None where it is no mode."""
    one = file.read(index)
    analysis = int(one.get("analysis_type", 0))
    if analysis not in (NORMAL, *COMPLEX) or "node_nums" not in one:
        return None
    frequency, damping = pole_of(one, kind, analysis)
    if not np.isfinite(frequency):
        return None
    nodes = np.atleast_1d(np.asarray(one["node_nums"], dtype=float)).astype(int).tolist()
    try:
        values = _out_of_plane(one, kind, out, nodes)
    except (KeyError, ValueError, IndexError) as error:
        raise MeasurementError(
            f"{path}: expected 1, 3 or 6 deflections for each node in the dataset {kind} at place {index + 1} of the "
            "file, got others. Export translations along x, y and z."
        ) from error
    if len(values) != len(nodes):
        raise MeasurementError(
            f"{path}: expected a deflection for each of {len(nodes)} nodes in the dataset {kind} at place "
            f"{index + 1} of the file, got {len(values)}. Export it again."
        )
    return _Mode(frequency, damping, dict(zip(nodes, values.tolist(), strict=True)), bool(np.iscomplexobj(values)))


def pole_of(one: Mapping[str, Any], kind: int, analysis: int) -> tuple[float, float]:
    """Frequency [Hz] and damping ratio, NaN where the file has 0 for it."""
    if analysis == NORMAL and kind == 55:
        frequency, viscous, hysteretic = (float(one[k]) for k in ("freq", "modal_damp_vis", "modal_damp_his"))
    elif analysis == NORMAL:
        frequency, viscous, hysteretic = (float(one.get(f"record12_field{k}", 0.0)) for k in (2, 5, 6))
    else:
        parts = [float(one.get(f"record13_field{k}", 0.0)) for k in (1, 2)]
        pole = complex(one["eig"]) if kind == 55 else complex(*parts)
        frequency, hysteretic = abs(pole) / (2 * np.pi), 0.0
        viscous = -pole.real / abs(pole) if abs(pole) > 0 else 0.0
        if pole == 0 and kind != 55:
            # Some programs leave the eigenvalue out and give the frequency where that of a normal mode stands.
            frequency, viscous = (float(one.get(f"record12_field{k}", 0.0)) for k in (2, 5))
    # A loss factor η damps a mode at its resonance as the ratio η/2 does.
    damping = viscous if viscous > 0 else hysteretic / 2
    return frequency, damping if damping > 0 else float("nan")


def _out_of_plane(one: Mapping[str, Any], kind: int, out: _Out, nodes: list[int]) -> np.ndarray:
    if kind == 55:
        if int(one["n_data_per_node"]) not in N_DIRECTION:
            raise ValueError
        table = np.stack([np.atleast_1d(one[f"r{axis}"]) for axis in (1, 2, 3)], axis=-1)
    else:
        n_value = int(one["number_of_data_values_for_the_data_component"])
        table = np.stack([np.asarray(row, dtype=float) for row in one["data_at_node"]])
        if int(one["data_type"]) in (5, 6):
            table = table[:, 0::2] + 1j * table[:, 1::2]
        if n_value not in (1, *N_DIRECTION) or table.shape[1] != n_value:
            raise ValueError
        if n_value == 1:
            return table[:, 0]
    values = table[:, out.normal - 1].copy()
    if len(values) == len(nodes):
        for row, node in enumerate(nodes):
            if node in out.turned:
                values[row] = table[row, :3] @ out.turned[node][:, out.normal - 1]
    return values


def _common(modes: Iterable[_Mode], notes: list[str]) -> list[int]:
    """Nodes that every mode has."""
    modes = list(modes)
    common = set.intersection(*(set(mode.shape) for mode in modes))
    every = set.union(*(set(mode.shape) for mode in modes))
    if n_out := len(every - common):
        notes.append(f"Left out {n_out} node{'s' * (n_out > 1)} that not every mode has.")
    return sorted(common)


def write_modal_uff(model: ModalModel, path: Path) -> None:
    """Write each mode as a dataset 55, real shapes as normal modes, complex ones as complex modes.

    The format has six digits. Points without a node's label are numbered from 1.

    Raises:
        MeasurementError: A node that is given two places.
    """
    points = model.point
    if not all(channel.node for channel in points):
        points = tuple(Channel(number, "w", channel.coordinate) for number, channel in enumerate(points, start=1))
    blocks = [units_block(), nodes_block(points, model.source)]
    columns = zip(model.frequency.tolist(), model.damping_ratio.nan_to_num(0.0).tolist(), model.shape, strict=True)
    for number, (hertz, ratio, shape) in enumerate(columns, start=1):
        if model.is_complex:
            omega = 2 * np.pi * hertz
            pole = complex(-ratio * omega, omega * max(0.0, 1 - ratio**2) ** 0.5)
            kind, facts = COMPLEX[0], [pole.real, pole.imag, 0.0, 0.0, 0.0, 0.0]
        else:
            kind, facts = NORMAL, [hertz, 0.0, ratio, 0.0]
        lines = [
            f"{55:6d}",
            *["NONE"] * 5,
            "".join(f"{value:10d}" for value in (1, kind, 2, 8, 5 if model.is_complex else 2, 3)),
            f"{2:10d}{len(facts):10d}{1:10d}{number:10d}",
            "".join(f"{value:13.5E}" for value in facts),
        ]
        for channel, value in zip(points, shape.tolist(), strict=True):
            parts = [0.0] * 4 + [value.real, value.imag] if model.is_complex else [0.0, 0.0, value]
            lines += [f"{channel.node:10d}", "".join(f"{part:13.5E}" for part in parts)]
        blocks.append(block(lines))
    Path(path).write_bytes(b"".join(blocks))
