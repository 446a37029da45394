"""Two dozen mistakes of units, files, paths and keys: each gets one sentence that names the remedy.

Those that are certain are refused, with exit status 2; the others are said before the search, which goes on.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import pytest

from torchplate.measurement import Measurement, write_uff

REFUSED, SAID = 2, 0


@dataclass(frozen=True)
class Mistake:
    """What a user got wrong.

    Args:
        status: of the command.
        words: that the sentence must hold: what came, and what to do.
        changes: to a config that works.
        prepare: what else is made in the folder.
        text: of the config as it is written, from what it would be.
        arguments: of the command, in the folder.
    """

    status: int
    words: list[str]
    changes: Mapping[str, Any] = field(default_factory=dict)
    prepare: Callable[[Any], object] = lambda _: None
    text: Callable[[str], str] = lambda text: text
    arguments: tuple[str, ...] = ("run", "plate.yaml", "--out", "out")


def scaled(gain: float) -> Callable[[Any], object]:
    return lambda bench: bench.measure(gain=gain)


def stated(kind: str) -> Callable[[Any], object]:
    """The file says another kind than it holds."""

    def prepare(bench: Any) -> None:
        frfs = Measurement.from_npz(bench.folder / "plate.npz")
        replace(frfs, kind=kind).to_npz(bench.folder / "plate.npz")

    return prepare


def uff(change: Callable[[bytes], bytes], places: float = 0.0) -> Callable[[Any], object]:
    """The measurement as a universal file, spoilt; with coordinates this many times those in metres."""

    def prepare(bench: Any) -> None:
        frfs = Measurement.from_npz(bench.folder / "plate.npz")
        if places:
            # Nodes of the 3 × 2 mesh of 0.41 × 0.29 m.
            def located(channel: Any) -> Any:
                row, column = divmod(channel.node - 1, 4)
                return replace(channel, coordinate=(places * 0.41 * column / 3, places * 0.29 * row / 2, 0.0))

            frfs = replace(
                frfs,
                response=tuple(located(channel) for channel in frfs.response),
                reference=tuple(located(channel) for channel in frfs.reference),
            )
        write_uff(frfs, bench.folder / "plate.uff")
        (bench.folder / "plate.uff").write_bytes(change((bench.folder / "plate.uff").read_bytes()))

    return prepare


def first_record(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    def change(content: bytes) -> bytes:
        assert old in content
        return content.replace(old, new, 1)

    return change


def first_line(bench: Any, frequency: float) -> None:
    """The file begins at this frequency [Hz]."""
    frfs = Measurement.from_npz(bench.folder / "plate.npz")
    lines = frfs.frequency.clone()
    lines[0] = frequency
    replace(frfs, frequency=lines).to_npz(bench.folder / "plate.npz")


UFF = {"measurement.file": "plate.uff"}

MISTAKES = {
    # Units
    "sides in mm": Mistake(
        REFUSED, ["mesh.length_x", "millimetres", "0.41"], {"mesh.length_x": 410.0, "mesh.length_y": 290.0}
    ),
    "sides in cm": Mistake(
        SAID, ["mesh.length_x", "centimetres", "0.41"], {"mesh.length_x": 41.0, "mesh.length_y": 29.0}
    ),
    "thickness in mm": Mistake(
        REFUSED, ["effects.plate.thickness", "millimetres", "0.0031"], {"effects.plate.thickness": 3.1}
    ),
    "thickness in cm": Mistake(
        REFUSED, ["effects.plate.thickness", "centimetres (write 0.0031)"], {"effects.plate.thickness": 0.31}
    ),
    "modulus in GPa": Mistake(
        REFUSED,
        ["effects.plate.youngs_modulus", "gigapascals", "[1.5e+11, 2.6e+11]"],
        {"effects.plate.youngs_modulus": [150, 260]},
    ),
    "modulus in psi": Mistake(
        SAID, ["effects.plate.youngs_modulus", "pounds per square inch"], {"effects.plate.youngs_modulus": [22e6, 38e6]}
    ),
    "density in g/cm³": Mistake(REFUSED, ["effects.plate.density", "g/cm³", "7700"], {"effects.plate.density": 7.7}),
    "magnet in g": Mistake(
        SAID,
        ["effects.magnet.mass", "grams", "0.024"],
        {"effects.magnet": {"effect": "point_mass", "x": 0.3, "y": 0.4, "mass": 24.0}},
    ),
    "loss factor in per cent": Mistake(
        SAID, ["loss_factor", "per cent", "0.012"], {"effects.loss.stiffness_loss_factor": 1.2}
    ),
    "level in g": Mistake(SAID, ["g that are labelled m/s²", "9.807", "gain: unknown"], prepare=scaled(1 / 9.80665)),
    "level in mm": Mistake(SAID, ["millimetres", "0.001", "gain: unknown"], prepare=scaled(1000.0)),
    "level without a unit": Mistake(SAID, ["0.02 times", "gain: unknown"], prepare=scaled(0.02)),
    "accelerance called mobility": Mistake(SAID, ["measurement.kind: accelerance"], prepare=stated("mobility")),
    "natural frequencies in rad/s": Mistake(
        SAID, ["rad/s", "divide by 2π"], {"measurement": {"natural_frequencies": {4: 497.0, 5: 542.0, 6: 1130.0}}}
    ),
    "band in kHz": Mistake(REFUSED, ["measurement.band", "2 to 400 Hz"], {"measurement.band": [0.008, 0.4]}),
    "band in kHz beside a line at 0 Hz": Mistake(
        SAID,
        ["measurement.band", "holds 1 line", "kHz", "write [30, 400]"],
        {"measurement.band": [0.03, 0.4]},
        lambda bench: first_line(bench, 0.25),
    ),
    "band in rad/s": Mistake(
        SAID,
        ["measurement.band", "2 to 400 Hz", "rad/s", "write [29.9, 400]"],
        {"measurement.band": [188, 2513]},
    ),
    "springs in N/mm": Mistake(
        SAID,
        ["effects.wires.stiffness", "1.31 N/m", "N/mm", "1310", "leave the supports out"],
        {"effects.wires.stiffness": 1.31},
    ),
    "interval of a loss factor in per cent": Mistake(
        SAID,
        ["effects.loss.stiffness_loss_factor", "per cent", "[0.001, 0.05]"],
        {"effects.loss.stiffness_loss_factor": [0.1, 5.0]},
    ),
    "Poisson's ratio in per cent": Mistake(
        REFUSED, ["plate.poisson_ratio", "per cent", "0.31"], {"effects.plate.poisson_ratio": 31}
    ),
    "place in mm": Mistake(
        REFUSED,
        ["magnet.x", "share of the side", "divide"],
        {"effects.magnet": {"effect": "point_mass", "x": 130.0, "y": 120.0, "mass": 0.02}},
    ),
    "mesh of one element": Mistake(
        SAID,
        ["mesh", "1 × 1 elements", "400 Hz", "mesh.refine"],
        {"mesh.n_x": 1, "mesh.n_y": 1, "effects.wires.nodes": [2]},
        uff(lambda content: content, places=1.0),
        arguments=("run", "plate.yaml", "--out", "out", "--set", "measurement.file=plate.uff"),
    ),
    "coordinates in mm": Mistake(
        REFUSED,
        ["measurement.file", "millimetres", "measurement.frame: {unit: mm}", "dataset 164"],
        UFF,
        uff(lambda content: content, places=1e3),
    ),
    # Files
    "table instead of FRFs": Mistake(
        REFUSED,
        ["measurement.file", "plate.csv", "UFF 58"],
        {"measurement.file": "plate.csv"},
        lambda bench: (bench.folder / "plate.csv").write_text("1,2\n"),
    ),
    "file cut short": Mistake(REFUSED, ["plate.uff", "cut short", "again"], UFF, uff(lambda content: content[:-900])),
    "function type 0": Mistake(
        SAID,
        ["1 record", "function type 0", "type 4"],
        UFF,
        uff(first_record(b"\n    4         0", b"\n    0         0")),
    ),
    "in-plane direction": Mistake(
        SAID,
        ["1 FRF that is not out of the plate", "4u/1w"],
        UFF,
        uff(first_record(b"         4   3", b"         4   1")),
    ),
    "nodes of another numbering": Mistake(
        SAID, ["node number", "3 × 2 mesh", "2411"], UFF, uff(lambda content: content)
    ),
    "measurement for a config": Mistake(
        REFUSED, ["plate.npz", "measurement.file", "torchplate inspect"], arguments=("run", "plate.npz")
    ),
    # Paths
    "path from the working folder": Mistake(
        REFUSED,
        ["measurement.file", "config's folder", "write ../plate.npz"],
        prepare=lambda bench: (
            bench.folder.joinpath("configs").mkdir(),
            bench.folder.joinpath("plate.yaml").rename(bench.folder / "configs" / "plate.yaml"),
        ),
        arguments=("run", "configs/plate.yaml"),
    ),
    "config misspelt": Mistake(REFUSED, ["plat.yaml", "plate.yaml?"], arguments=("run", "plat.yaml")),
    "results into a file": Mistake(
        REFUSED, ["--out plate.npz", "Name another place"], arguments=("run", "plate.yaml", "--out", "plate.npz")
    ),
    "config of Windows": Mistake(
        REFUSED,
        ["moved.yaml", "got UTF-16", "Save it as UTF-8"],
        prepare=lambda bench: (bench.folder / "moved.yaml").write_text("mesh: {n_x: 3}", encoding="utf-16"),
        arguments=("run", "moved.yaml"),
    ),
    # Keys
    "key misspelt": Mistake(REFUSED, ["mesh.lenght_x", "'length_x'?"], {"mesh.lenght_x": 0.4}),
    "key twice": Mistake(
        REFUSED,
        ["search.seed", "Keep one"],
        text=lambda text: text.replace('"search": {', '"search": {"seed": 1, ', 1),
    ),
    "unit in a number": Mistake(
        REFUSED, ["effects.plate.thickness", "3.1 mm", "without the unit"], {"effects.plate.thickness": "3.1 mm"}
    ),
    "decimal comma": Mistake(
        REFUSED, ["effects.plate.thickness", "0,0031", "decimal point"], {"effects.plate.thickness": "0,0031"}
    ),
    "setting of another search": Mistake(REFUSED, ["search.limit", "There are: strategy"], {"search.limit": 20}),
    "tab": Mistake(REFUSED, ["line 2", "tab", "blanks"], text=lambda _: "mesh:\n\tlength_x: 0.4\n"),
    "band that is no list": Mistake(
        REFUSED, ["measurement.band", "a list", "'30-400'", "[5.0, 400.0]"], {"measurement.band": "30-400"}
    ),
    "band of nothing": Mistake(REFUSED, ["measurement.band", "[5.0, 400.0]"], {"measurement.band": []}),
    "objective that is a word": Mistake(REFUSED, ["objective:", "keys", "'frac'", "kind"], {"objective": "frac"}),
    "nodes that are a word": Mistake(
        REFUSED, ["effects.wires.nodes", "a list", "'2-10'"], {"effects.wires.nodes": "2-10"}
    ),
    "natural frequencies in a list": Mistake(
        REFUSED,
        ["measurement.natural_frequencies", "keys with values", "4: 68.4"],
        {"measurement": {"natural_frequencies": [41.0, 62.0]}},
    ),
    "no natural frequency": Mistake(
        REFUSED,
        ["plate.yaml: measurement.natural_frequencies: Expected", "{1: 4.5, 6: 70.5}"],
        {"measurement": {"natural_frequencies": {}}},
    ),
    "interval of one number": Mistake(
        REFUSED, ["effects.plate.density", "Write the number alone"], {"effects.plate.density": [7700, 7700]}
    ),
    "optimizer by its letters": Mistake(
        REFUSED, ["search.optimizer", "'DE'", "Did you mean 'differential_evolution'?"], {"search.optimizer": "DE"}
    ),
    "node twice": Mistake(REFUSED, ["effects.wires", "each node once", "2"], {"effects.wires.nodes": [2, 2, 11]}),
    "--set without a sign": Mistake(
        REFUSED, ["--set search.seed", "search.seed=3"], arguments=("run", "plate.yaml", "--set", "search.seed", "3")
    ),
    "node off the grid": Mistake(REFUSED, ["effects.wires.nodes", "1 to 12", "13"], {"effects.wires.nodes": [2, 13]}),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_gets_one_sentence_with_its_remedy(bench, make_config, command, monkeypatch, case):
    mistake = MISTAKES[case]
    monkeypatch.chdir(bench.folder)
    searched = [] if "effects.loss.stiffness_loss_factor" in mistake.changes else ["loss.stiffness_loss_factor"]
    content = json.dumps(make_config(searched, {"search.n_generation": 1} | mistake.changes))
    bench.write(mistake.text(content))
    mistake.prepare(bench)
    status, stdout, stderr = command(*mistake.arguments)
    assert status == mistake.status, stderr
    lines = stderr.splitlines()
    if mistake.status == SAID:
        assert not lines
        lines = [line for line in stdout.splitlines() if line.startswith("  Note: ")]
        lines = [line for line in lines if all(word in line for word in mistake.words)] or lines
    assert len(lines) == 1, lines
    assert all(word in lines[0] for word in mistake.words), lines[0]


def test_there_are_two_dozen_of_them():
    assert len(MISTAKES) >= 24
