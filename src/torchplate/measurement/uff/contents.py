"""What a universal file holds, dataset by dataset, and what can be done with it here.

Source: Universal File Format, University of Cincinnati SDRL: datasets 15, 18, 55, 58, 82, 151, 164, 2411, 2412, 2414,
2420, 2467.
"""

import shlex
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from torchplate.measurement.formats.parsing import reads
from torchplate.measurement.level import FORCE, MOTION, kind_of, likely_kind
from torchplate.measurement.measurement import KINDS, MeasurementError
from torchplate.measurement.uff.dataset import UffFile, open_uff
from torchplate.measurement.uff.modes import COMPLEX, NORMAL, pole_of
from torchplate.notation import counted, percent

FUNCTION: Final = {
    0: "general or unknown function",
    1: "time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    7: "auto correlation",
    8: "cross correlation",
    9: "power spectral density",
    10: "energy spectral density",
    11: "probability density",
    12: "spectrum",
    13: "cumulative frequency distribution",
    14: "peaks valley",
    16: "stress/cycles",
    17: "strain/cycles",
    18: "orbit",
    19: "mode indicator function",
    20: "force pattern",
    21: "partial power",
    22: "partial coherence",
    23: "eigenvalue",
    24: "eigenvector",
    25: "shock response spectrum",
    26: "finite impulse response filter",
    27: "multiple coherence",
    28: "order function",
}
"""Function types of dataset 58."""
QUANTITY: Final = MOTION | FORCE | {1: "general", 2: "stress", 3: "strain", 5: "temperature", 15: "pressure"}
QUANTITY_ALSO: Final = {16: "mass", 17: "time", 18: "frequency", 19: "rpm", 21: "sound pressure"}
SI_OF_AXIS: Final = {17: "s", 18: "Hz"}
"""By the specific data type of the abscissa, where the file writes no unit."""
UNIT_CODE: Final = {
    1: "m, N",
    2: "ft, lbf",
    3: "m, kgf",
    4: "ft, pdl",
    5: "mm, mN",
    6: "cm, cN",
    7: "in, lbf",
    8: "mm, kgf",
    9: "its own units",
}
ELEMENT: Final = {
    11: "rod",
    21: "beam",
    22: "beam",
    24: "beam",
    41: "triangle",
    44: "quad",
    91: "triangle",
    94: "quad",
    111: "tetrahedron",
    112: "wedge",
    115: "brick",
}
# Steps that differ by less, relative to themselves, are those of one step written with few digits.
EVEN = 1e-4
PLURAL: Final = {"tetrahedron": "tetrahedra"}
ANALYSIS: Final = {
    0: "unknown",
    1: "static",
    2: "normal mode",
    3: "complex mode",
    4: "transient",
    5: "frequency response",
    6: "buckling",
    7: "complex mode",
}


class Part(NamedTuple):
    """One kind of content.

    Attributes:
        what: Which datasets, how many.
        detail: What is in them.
        use: What torchplate does with them, with the command or key.
    """

    what: str
    detail: str
    use: str


class Held(NamedTuple):
    """All datasets of one number in a file."""

    file: UffFile
    kind: int
    indices: tuple[int, ...]
    path: Path

    @property
    def title(self) -> str:
        """Number and count in words."""
        return f"dataset {self.kind}" + (f", {len(self.indices)} times" if len(self.indices) > 1 else "")


class Contents(NamedTuple):
    """A universal file, described.

    Attributes:
        parts: Its contents by kind.
        has_frf: Whether FRFs or transmissibilities are among them.
        has_time: Whether time records are.
        new: What follows `torchplate new FILE`: the kind where the file does not say it, a table of places where it
            holds none.
    """

    parts: tuple[Part, ...]
    has_frf: bool
    has_time: bool
    new: str = ""


@reads("a universal file")
def describe(path: Path) -> Contents:
    """Describe a universal file; a dataset that does not parse is said to be one.

    Raises:
        MeasurementError: The file is no universal file, or cannot be read.
    """
    file = open_uff(path)
    by_type: dict[int, list[int]] = defaultdict(list)
    for index, kind in enumerate(file.types):
        by_type[kind].append(index)
    parts: list[Part] = []
    functions: set[int] = set()
    for kind, indices in by_type.items():
        if kind == 58:
            found, functions = _functions(file, indices, path)
            parts += found
            continue
        held = Held(file, kind, tuple(indices), path)
        try:
            parts.append(_DESCRIBE.get(kind, _other)(held))
        except (MeasurementError, KeyError, ValueError, IndexError, TypeError):
            parts.append(Part(held.title, "does not parse", "not used: export it again, or leave it out"))
    return Contents(tuple(parts), bool(functions & {4, 5}), 1 in functions, _told_to_new(file)[0])


def _other(held: Held) -> Part:
    return Part(held.title, "of a kind that is not described here", "not used")


def _header(held: Held) -> Part:
    one = held.file.read(held.indices[0])
    words = [str(one.get(key, "")).strip() for key in ("model_name", "description", "db_app", "program")]
    return Part(held.title, "file header: " + ", ".join(w for w in words if w and w != "NONE"), "shown only")


def _units(held: Held) -> Part:
    one = held.file.read(held.indices[0])
    code = int(one["units_code"])
    detail = f"units: code {code} ({UNIT_CODE.get(code, 'unknown')}), {one['length']:g} lengths per metre"
    return Part(held.title, detail, "coordinates and levels are turned into m and N by it")


def _nodes(held: Held) -> Part:
    tables = [held.file.read(index) for index in held.indices]
    labels = np.concatenate([np.asarray(t["node_nums"], dtype=float) for t in tables]).astype(int)
    xyz = np.stack([np.concatenate([np.asarray(t[axis], dtype=float) for t in tables]) for axis in "xyz"])
    if not labels.size:
        return Part(held.title, "geometry without a node", "not used")
    spans = [
        f"{axis} {row.min():g}" + (f" to {row.max():g}" if row.max() > row.min() else "")
        for axis, row in zip("xyz", xyz, strict=True)
    ]
    systems = {int(x) for t in tables for x in np.asarray(t["def_cs"], dtype=float)} - {0, 1}
    detail = (
        f"geometry: {counted(labels.size, 'node')}, labels {labels.min()} to {labels.max()}, "
        f"{', '.join(spans)} (file's unit)"
    )
    if systems:
        detail += f"; as stated in {counted(len(systems), 'coordinate system')} of their own"
    flat = np.linalg.matrix_rank(xyz - xyz.mean(axis=1, keepdims=True), tol=0.01 * max(float(np.ptp(xyz)), 1e-12)) < 3
    detail += "; in one plane" if flat else "; not in one plane"
    name = shlex.quote(held.path.name)
    own = f"places of the FRFs: torchplate new {name}{_told_to_new(held.file)[0]}"
    use = own if _frfs(held.file) else f"places for the FRFs of another file: torchplate new FRFS.uff --nodes {name}"
    return Part(held.title, detail, use if flat else f"not a plate as a whole; {use}")


def _frfs(file: UffFile) -> list[dict[str, Any]]:
    """Headers of the FRFs and transmissibilities."""
    found = []
    for index in file.of_type(58):
        # One that does not parse is said to be so where records are described.
        with suppress(MeasurementError):
            header = file.header(index)
            found += [header] if header.get("func_type") in (4, 5) else []
    return found


def _told_to_new(file: UffFile) -> tuple[str, str]:
    """What `torchplate new` must be told beside the file, and why where it is the kind."""
    try:
        frfs = _frfs(file)
        stated, likely = set(), set()
        for one in frfs:
            over, under = int(one["ordinate_spec_data_type"]), int(one["orddenom_spec_data_type"])
            stated.add(kind_of(over, under, int(one["func_type"])))
            likely.add(likely_kind(over, str(one.get("ordinate_axis_units_lab", ""))))
    except (MeasurementError, KeyError, ValueError):
        return "", ""
    nodes = "" if {15, 2411} & set(file.types) or not frfs else " --nodes nodes.csv"
    if None not in stated and len(stated) < 2:
        return nodes, ""
    likely -= {None}
    if len(likely) == 1:
        (kind,) = likely
        return f" --kind {kind}{nodes}", "; the file does not say the kind, its unit or quantity suggests this one"
    # Any would run: hits are mostly heard by accelerometers.
    return f" --kind accelerance{nodes}", f"; the file does not say which of {', '.join(KINDS)} it is"


def _systems(held: Held) -> Part:
    names: list[str] = []
    for index in held.indices:
        one = held.file.read(index)
        found = one.get("cs_name", one.get("CS_names", ""))
        names += [str(found)] if isinstance(found, str) else [str(name) for name in found]
    shown = ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")
    return Part(
        held.title,
        f"{counted(len(names), 'coordinate system')}: {shown}",
        "places and directions of nodes that name one of them are turned into the global system",
    )


def _lines(held: Held) -> Part:
    counts = [len(np.flatnonzero(np.asarray(held.file.read(index)["nodes"]))) for index in held.indices]
    return Part(held.title, f"trace lines through {counted(sum(counts), 'node')}", "shown only: a mesh is made anew")


def _elements(held: Held) -> Part:
    counts: Counter[str] = Counter()
    for index in held.indices:
        # pyuff lists triangles and quads a second time, by name.
        for kind_number, group in held.file.read(index).items():
            if isinstance(kind_number, int):
                counts[ELEMENT.get(kind_number, f"element of type {kind_number}")] += len(group)
    named = [counted(n, name, PLURAL.get(name, "")) for name, n in counts.items()]
    detail = ", ".join(named) or "none that is known here"
    return Part(held.title, f"elements: {detail}", "shown only: a mesh is made anew")


def _groups(held: Held) -> Part:
    return Part(held.title, "groups of nodes or elements", "shown only")


def _shapes(held: Held) -> Part:
    modes: list[tuple[float, float]] = []
    kinds: Counter[str] = Counter()
    nodes: set[int] = set()
    for index in held.indices:
        one = held.file.read(index)
        analysis = int(one.get("analysis_type", 0))
        kinds[ANALYSIS.get(analysis, "unknown")] += 1
        nodes |= {int(n) for n in np.atleast_1d(np.asarray(one.get("node_nums", []), dtype=float))}
        if analysis in (NORMAL, *COMPLEX):
            pole = pole_of(one, held.kind, analysis)
            modes += [pole] if pole[0] > 0 else []
    what = ", ".join(f"{n} of a {name}" for name, n in kinds.items())
    detail = f"data at {counted(len(nodes), 'node')}: {what}"
    if not modes:
        return Part(held.title, detail, "not used: no mode with a natural frequency is among them")
    modes.sort()
    shown = ", ".join(f"{f:.5g} Hz" + (f" ({percent(d, 2)})" if d > 0 else "") for f, d in modes[:12])
    use = f"in a config: measurement: {{modal_model: {{file: {shlex.quote(held.path.name)}}}}}"
    return Part(held.title, f"{detail}; {shown}" + (", ..." if len(modes) > 12 else ""), use)


def _functions(file: UffFile, indices: Sequence[int], path: Path) -> tuple[list[Part], set[int]]:
    groups: dict[tuple[int, int, int, int], list[dict[str, Any]]] = defaultdict(list)
    firsts: dict[tuple[int, int, int, int], int] = {}
    broken = 0
    for index in indices:
        try:
            header = file.header(index)
            quantities = (int(header["ordinate_spec_data_type"]), int(header["orddenom_spec_data_type"]))
            key = (int(header["func_type"]), int(header["num_pts"]), *quantities)
            groups[key].append(header)
            firsts.setdefault(key, index)
        except (MeasurementError, KeyError, ValueError):
            broken += 1
    parts = []
    told = _told_to_new(file)
    forces = any(key[0] == 1 and key[2] in FORCE for key in groups)
    for (function, n, over, under), headers in sorted(groups.items(), key=lambda item: item[0]):
        first = headers[0]
        name = FUNCTION.get(function, f"function type {function}")
        lines = _abscissa(file, firsts[function, n, over, under], first)
        detail = f"{counted(n, 'value')}, {lines}, {_quantity(over, under, first)}, {_channels(headers)}"
        use = _use_of(function, over, forces, path, told)
        parts.append(Part(f"dataset 58, {len(headers)} × {name}", detail, use))
    if broken:
        parts.append(Part(f"dataset 58, {broken} times", "header does not parse", "not used: export it again"))
    return parts, {key[0] for key in groups}


def _abscissa(file: UffFile, index: int, header: dict[str, Any]) -> str:
    """First and last line of a dataset 58 and their step, by its header or, where that has none, by its values."""
    unit = str(header.get("abscissa_axis_units_lab", "")).strip()
    if unit in ("", "NONE"):
        unit = SI_OF_AXIS.get(int(header.get("abscissa_spec_data_type", 0)), "")
    n, step = int(header["num_pts"]), float(header["abscissa_inc"])
    start = float(header["abscissa_min"])
    end = start + step * max(n - 1, 0)
    if int(header["abscissa_spacing"]) != 1:
        try:
            line = np.asarray(file.read(index)["x"], dtype=float)
            start, end = float(line[0]), float(line[-1])
        except (MeasurementError, KeyError, ValueError, IndexError):
            return f"uneven spacing [{unit or '?'}]"
        step = (end - start) / max(len(line) - 1, 1)
        if bool((np.abs(np.diff(line) - step) > EVEN * abs(step)).any()):
            return f"{start:g} to {end:g} {unit}".strip() + ", uneven spacing"
    span = f"{start:g} to {end:g} {unit}".strip()
    return f"{span}, step {step:g}" + (f" ({1 / step:g} Hz)" if int(header["func_type"]) == 1 and step > 0 else "")


def _quantity(over: int, under: int, header: dict[str, Any]) -> str:
    names = QUANTITY | QUANTITY_ALSO
    unit = str(header.get("ordinate_axis_units_lab", "")).strip()
    word = names.get(over, "quantity not named")
    word += f" over {names.get(under, 'quantity not named')}" if under else ""
    return word + (f" [{unit}]" if unit and unit != "NONE" else "")


def _channels(headers: Sequence[dict[str, Any]]) -> str:
    labels = []
    for header in headers:
        response = f"{int(header['rsp_node'])}{_direction(int(header['rsp_dir']))}"
        reference = f"{int(header['ref_node'])}{_direction(int(header['ref_dir']))}"
        labels.append(response if int(header["func_type"]) in (1, 2, 9) else f"{response}/{reference}")
    unique = list(dict.fromkeys(labels))
    return "channel" + ("s " if len(unique) > 1 else " ") + ", ".join(unique[:8]) + (" ..." if len(unique) > 8 else "")


def _direction(direction: int) -> str:
    sign = "-" if direction < 0 else ""
    return sign + ("", "x", "y", "z", "rx", "ry", "rz")[abs(direction)] if abs(direction) <= 6 else f"?{direction}"


def _use_of(function: int, over: int, forces: bool, path: Path, told: tuple[str, str]) -> str:
    if function in (4, 5):
        return f"the measurement of a run: torchplate new {shlex.quote(path.name)}{told[0]}{told[1]}"
    if function == 6:
        return "read with the FRFs of the same channels"
    if function == 1 and (over in FORCE or over in MOTION or over in (0, 1)):
        if forces:
            return f"FRFs from hits: torchplate frf {shlex.quote(path.name)} --out FRFS.uff"
        return f"FRFs need the force beside it: torchplate frf {shlex.quote(path.name)} FORCE.uff --out FRFS.uff"
    if function == 1:
        return "not used: a plate is hit with a force and answers with a motion"
    if function in (2, 3, 7, 8, 9, 10, 12, 19, 25):
        return "not used, since it holds no force; its peaks may be given as measurement.natural_frequencies"
    if function == 0:
        return "not used: if these are FRFs, export them as function type 4"
    return "not used"


_DESCRIBE: Final[dict[int, Callable[[Held], Part]]] = {
    15: _nodes,
    18: _systems,
    55: _shapes,
    82: _lines,
    151: _header,
    164: _units,
    2411: _nodes,
    2412: _elements,
    2414: _shapes,
    2420: _systems,
    2467: _groups,
}
