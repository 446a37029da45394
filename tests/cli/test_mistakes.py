"""Mistakes of units, files, paths and keys: each gets one sentence that names the remedy.

Those that are certain are refused, with exit status 2; the others are said before the search, which goes on.
"""

import gzip
import json
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile

from torchplate.cli.main import main
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


def real_parts(bench: Any) -> None:
    frfs = Measurement.from_npz(bench.folder / "plate.npz")
    replace(frfs, frf=frfs.frf.real.to(frfs.frf)).to_npz(bench.folder / "plate.npz")


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


def amplitudes(bench: Any) -> None:
    """The archive holds |H|."""
    with np.load(bench.folder / "plate.npz") as archive:
        held = {key: archive[key] for key in archive.files}
    np.savez(bench.folder / "plate.npz", **held | {"frf": np.abs(held["frf"])})


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
    "density in kg/mm³": Mistake(REFUSED, ["looks like kg/mm³ (write 7700)"], {"effects.plate.density": 7.7e-6}),
    "density in lb/ft³": Mistake(
        SAID, ["It would fit", "effects.plate.density in lb/ft³ (write 7705)"], {"effects.plate.density": 481.0}
    ),
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
    "two configs in one file": Mistake(
        REFUSED, ["Expected one config", "line 2", "a file of its own"], text=lambda _: "mesh: {}\n---\nmesh: {}\n"
    ),
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
    # Of files and paths
    "coordinates in inches": Mistake(
        REFUSED, ["look like inches", "measurement.frame: {unit: in}"], UFF, uff(lambda content: content, places=39.37)
    ),
    "coordinates in cm": Mistake(
        REFUSED,
        ["look like centimetres", "measurement.frame: {unit: cm}"],
        UFF,
        uff(lambda content: content, places=100),
    ),
    "compressed file": Mistake(REFUSED, ["plate.uff", "compressed", "Unpack it"], UFF, uff(gzip.compress)),
    "amplitudes in an archive": Mistake(
        REFUSED, ["plate.npz", "amplitudes without a phase", "complex values"], prepare=amplitudes
    ),
    "folder for a config": Mistake(REFUSED, ["a folder", "plate.yaml"], arguments=("run", ".")),
    "folder for a measurement": Mistake(REFUSED, ["the folder", "Name a .uff or .npz file"], {"measurement.file": "."}),
    "config for a measurement": Mistake(
        REFUSED, ["a config", "`torchplate run plate.yaml`"], arguments=("new", "plate.yaml")
    ),
    "config to be inspected": Mistake(REFUSED, ["a config", "torchplate run"], arguments=("inspect", "plate.yaml")),
    "path in another letter case": Mistake(REFUSED, ["Plate.npz", "plate.npz?"], {"measurement.file": "Plate.npz"}),
    "path from home": Mistake(REFUSED, ["~ is not followed"], {"measurement.file": "~/plate.npz"}),
    "path of Windows": Mistake(
        REFUSED, ["double quotes", "line 2", "/"], text=lambda _: 'measurement:\n  file: "C:\\data\\plate.uff"\n'
    ),
    "path with a line break": Mistake(
        REFUSED,
        [r"data\new.npz", "double quotes", "write / instead"],
        text=lambda text: text.replace('"plate.npz"', r'"data\new.npz"'),
    ),
    "two files of one test": Mistake(
        REFUSED, ["measurement.file", "the path of one file"], {"measurement.file": ["plate.npz", "plate.npz"]}
    ),
    "sound of one channel": Mistake(
        REFUSED,
        ["a force and at least one response", "beside the responses."],
        prepare=lambda bench: wavfile.write(bench.folder / "hit_3.wav", 4096, np.zeros(4096, dtype=np.int16)),
        arguments=("frf", "hit_3.wav", "--response", "1", "--out", "frf.uff"),
    ),
    "empty config": Mistake(REFUSED, ["an empty file", "torchplate keys"], text=lambda _: ""),
    "config in the words of another program": Mistake(
        REFUSED, ["'length_x = 0.41' in line 2", "a colon"], text=lambda _: "[mesh]\nlength_x = 0.41\n"
    ),
    # Of units
    "density of air in g/cm³": Mistake(
        SAID,
        ["effects.air.density", "g/cm³", "write 1.2"],
        {"effects.air": {"effect": "air_loading", "density": 1.2e-3}},
    ),
    "angle in degrees": Mistake(
        SAID,
        ["effects.grain.angle", "45 rad", "in degrees, write 0.7854"],
        {
            "effects.wood": {"effect": "orthotropy", "young_ratio": 0.1, "shear_factor": 0.5},
            "effects.grain": {"effect": "grain_angle", "angle": 45.0},
        },
    ),
    "hits off their marks in mm": Mistake(
        SAID,
        ["measurement.position_std", "a tenth of the longer side", "write 0.002"],
        {"measurement.position_std": 2.0},
    ),
    # Of values and keys
    "edge in another program's word": Mistake(REFUSED, ["'fixed'", "Write clamped"], {"mesh.edges": {"x0": "fixed"}}),
    "kind by its motion": Mistake(
        REFUSED, ["'acceleration'", "Write accelerance"], {"measurement.kind": "acceleration"}
    ),
    "band from high to low": Mistake(REFUSED, ["400 to 8 Hz", "Swap the ends"], {"measurement.band": [400.0, 8.0]}),
    "band of three": Mistake(REFUSED, ["a list of 2", "[5.0, 400.0]"], {"measurement.band": [5.0, 100.0, 400.0]}),
    "band with its unit": Mistake(REFUSED, ["without the unit, got '8 Hz'"], {"measurement.band": ["8 Hz", "400 Hz"]}),
    "part of an element": Mistake(REFUSED, ["mesh.n_x", "a whole number, got 3.5"], {"mesh.n_x": 3.5}),
    "interval by other words": Mistake(
        REFUSED, ["{low: , high: }", "'min'"], {"effects.plate.youngs_modulus": {"min": 1.5e11, "max": 2.6e11}}
    ),
    "value left out": Mistake(REFUSED, ["effects.plate.density", "got nothing"], {"effects.plate.density": None}),
    "key without its section": Mistake(
        REFUSED, ["'search.n_generation'?"], arguments=("run", "plate.yaml", "--set", "n_generation=5")
    ),
    "effect misspelt in --set": Mistake(
        REFUSED, ["'plat'", "'plate'?", "wires"], arguments=("run", "plate.yaml", "--set", "effects.plat.density=7700")
    ),
    "numbers without the rigid-body modes": Mistake(
        SAID,
        ["leave the plate's 3 rigid-body modes out", "{4: 79, 5: 86.2, 6: 180}"],
        {"measurement": {"natural_frequencies": {1: 79.0, 2: 86.2, 3: 180.0}}},
    ),
    "numbers that count six rigid-body modes": Mistake(
        SAID,
        ["count 6 and not 3 rigid-body modes", "{4: 79, 5: 86.2, 6: 180}"],
        {"measurement": {"natural_frequencies": {7: 79.0, 8: 86.2, 9: 180.0}}},
    ),
    # Between brackets, between lines, and below another section
    "decimal comma between brackets": Mistake(
        REFUSED,
        ["a decimal point, got 0,0031 in line 2. Write 0.0031."],
        text=lambda _: "effects:\n  plate: {effect: plate, thickness: 0,0031, density: 7700}\n",
    ),
    "colon left out": Mistake(
        REFUSED,
        ["`key: value`, got 'length_y 0.29' in line 3", "a colon and a blank"],
        text=lambda _: "mesh:\n  length_x: 0.41\n  length_y 0.29\n  n_x: 3\n",
    ),
    "colon of a section left out": Mistake(
        REFUSED,
        ["'length_x: 0.41' in line 2", "End that one with a colon"],
        text=lambda _: "mesh\n  length_x: 0.41\n",
    ),
    "bracket left open": Mistake(
        REFUSED,
        ["line 2", "'plate: {effect: plate'", "not closed. Write }"],
        text=lambda _: "effects:\n  plate: {effect: plate\n  loss: {effect: hysteretic_damping}\n",
    ),
    "number in octal": Mistake(
        REFUSED,
        ["a decimal number, got 011 in line 3, which YAML takes as octal, 9. Write 11."],
        text=lambda _: "effects:\n  wires:\n    nodes: [2, 5, 011]\n",
    ),
    "number to the base 60": Mistake(
        REFUSED,
        ["got 1:30 in line 2, which YAML takes as a number to the base 60, 90"],
        text=lambda _: "mesh:\n  length_x: 1:30\n",
    ),
    "octal in --set": Mistake(REFUSED, ["--set", "octal, 8"], arguments=("run", "plate.yaml", "--set", "mesh.n_x=010")),
    "thickness and side exchanged": Mistake(
        REFUSED,
        ["thickness", "shorter side, 0.0031 m, got 0.41", "Were the two exchanged?"],
        {"mesh.length_x": 0.0031, "effects.plate.thickness": 0.41},
    ),
    "thickness beside the sides": Mistake(
        REFUSED, ["Did you mean 'effects.plate.thickness'?"], {"mesh.thickness": 0.0031}
    ),
    "side beside the thickness": Mistake(REFUSED, ["Did you mean 'mesh.length_x'?"], {"effects.plate.length_x": 0.41}),
    "effect beside the sections": Mistake(REFUSED, ["Did you mean 'effects.plate'?"], {"plate": {"thickness": 0.0031}}),
    "key of two sections": Mistake(REFUSED, ["Did you mean 'search.seed' or 'modal_test.seed'?"], {"seed": 3}),
    "setting in SciPy's word": Mistake(REFUSED, ["'popsize' here. Write n_member."], {"search.popsize": 15}),
    "effect without its name": Mistake(
        REFUSED, ["Add `effect: point_mass`"], {"effects.magnet": {"x": 0.3, "y": 0.4, "mass": 0.02}}
    ),
    "edge by its letter": Mistake(REFUSED, ["got 'C'. Write clamped"], {"mesh.edges": {"x0": "C"}}),
    "unit in full": Mistake(REFUSED, ["'millimeter'. Write mm"], {"measurement.frame": {"unit": "millimeter"}}),
    "place without brackets of its own": Mistake(
        REFUSED,
        ["effects.cords.at", "[[0.1, 0.2]]", "each place in brackets of its own"],
        {"effects.cords": {"effect": "support_spring", "at": [0.1, 0.2], "stiffness": 40.0}},
    ),
    "folder to be inspected": Mistake(
        REFUSED, ["a folder. Name a .uff or .npz file in it"], arguments=("inspect", ".")
    ),
    "folder for a new config": Mistake(REFUSED, ["a folder. Name a .uff or .npz file in it"], arguments=("new", ".")),
    # Of numbers that may be, and symbols
    "sides exchanged": Mistake(
        REFUSED,
        ["With the sides exchanged", "length_x 0.41, length_y 0.29?"],
        UFF | {"mesh.length_x": 0.29, "mesh.length_y": 0.41},
        uff(lambda content: content, places=1.0),
    ),
    "symbol for a name": Mistake(
        REFUSED, ["No key or name 'E' here. Write youngs_modulus."], {"effects.plate.E": 7e10}
    ),
    "damping ratio": Mistake(
        REFUSED, ["'damping_ratio'", "stiffness_loss_factor, which is twice"], {"effects.loss.damping_ratio": 0.002}
    ),
    "edge by its side": Mistake(REFUSED, ["'left'", "x0 is the edge at x = 0"], {"mesh.edges": {"left": "clamped"}}),
    "one node without brackets": Mistake(REFUSED, ["a list, got 2. Write [2]"], {"effects.wires.nodes": 2}),
    "standard deviation beyond its value": Mistake(
        SAID,
        ["effects.plate.thickness", "0.05, is larger than the value, 0.0031", "If it is in per cent", "write 1.55e-06"],
        {"effects.plate.thickness": {"value": 0.0031, "std": 0.05}},
    ),
    "standard deviation of a frequency in per cent": Mistake(
        SAID,
        ["measurement.natural_frequencies.4", "is larger than the value, 79"],
        {"measurement": {"natural_frequencies": {4: {"value": 79.0, "std": 100.0}, 5: 86.2}}},
    ),
    "calibration in per cent": Mistake(
        SAID,
        ["measurement.calibration_std", "100 % of the level", "write 0.01"],
        {"measurement.calibration_std": 1.0},
    ),
    "drift in per cent": Mistake(
        SAID, ["measurement.frequency_drift", "per cent, write 0.001"], {"measurement.frequency_drift": 0.1}
    ),
    "sensor's place in mm": Mistake(
        SAID,
        ["effects.off.dx", "2 m is more than the longer side", "in mm, write 0.002"],
        {"effects.off": {"effect": "sensor_position", "dx": 2.0, "dy": 0.0}},
    ),
    "delay in ms": Mistake(
        SAID, ["effects.late.delay", "in ms, write 0.0015"], {"effects.late": {"effect": "time_delay", "delay": 1.5}}
    ),
    "ratio of sides in per cent": Mistake(
        SAID,
        ["effects.long.ratio", "1 leaves the plate as it was", "write 1.02"],
        {"effects.long": {"effect": "aspect_ratio", "ratio": 102.0}},
    ),
    "stiffness that is left in per cent": Mistake(
        SAID,
        ["effects.soft.factor", "in per cent, write 0.5"],
        {"effects.soft": {"effect": "stiffness_loss", "x": 0.4, "y": 0.6, "size": 0.3, "factor": 50.0}},
    ),
    # Numbers of another plate, usual ones by themselves
    "density of aluminium beside a table": Mistake(
        SAID,
        ["times the measured ones", "effects.plate.density 9717", "weigh the plate"],
        {"measurement": {"natural_frequencies": {4: 79.0, 5: 86.2, 6: 180.0}}, "effects.plate.density": 2700.0},
    ),
    "places of supports in m": Mistake(
        SAID,
        ["effects.cords.at", "as metres", "write [[0.122, 0], [0.878, 0]]"],
        {"effects.cords": {"effect": "support_spring", "at": [[0.05, 0.0], [0.36, 0.0]], "stiffness": 40.0}},
    ),
    "time constant of a window for its rate": Mistake(
        SAID,
        ["effects.window.rate", "time constant, write 14.3"],
        {"effects.window": {"effect": "exponential_window", "rate": 0.07}},
    ),
    "label that is a number": Mistake(
        REFUSED,
        ["effects.7: Expected a text before the colon, got 7. Write '7', in quotes."],
        text=lambda text: text.replace('"wires":', "7:"),
    ),
    "mode that is no whole number": Mistake(
        REFUSED,
        ["natural_frequencies.4.5: Expected a whole number before the colon, got 4.5."],
        text=lambda text: text.replace('"band": [8.0, 400.0]', '"natural_frequencies": {4.5: 41.0}'),
    ),
    "file without a name": Mistake(
        REFUSED,
        ["measurement.file: Expected a file, got the folder '.'. Name a .uff or .npz"],
        {"measurement.file": ""},
    ),
    "text that is none": Mistake(REFUSED, ["objective.kind: Expected a text, got nothing"], {"objective.kind": None}),
    "FRFs without imaginary parts": Mistake(
        SAID, ["All FRFs are real numbers", "export complex values"], prepare=real_parts
    ),
    "rate of a window in per cent": Mistake(
        SAID,
        ["effects.window.rate", "95 1/s makes every peak 30.2 Hz wide", "If the window falls to 95 %"],
        {"effects.window": {"effect": "exponential_window", "rate": 95.0}},
    ),
}


# Every fifth tells each day whether sentences come at all; `make check` makes all the mistakes.
@pytest.mark.parametrize(
    "case", [one if k % 5 == 0 else pytest.param(one, marks=pytest.mark.check) for k, one in enumerate(MISTAKES)]
)
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


@pytest.mark.parametrize("name", [os.fsdecode(b"Pr\xfcfstand"), "a\0b"])
@pytest.mark.parametrize("verb", ["run", "inspect", "simulate"])
def test_a_name_in_other_bytes_than_utf_8_is_said(bench, make_config, command, monkeypatch, verb, name):
    """As of a disk that was written in Latin-1: neither a report nor a config can hold it."""
    monkeypatch.chdir(bench.folder)
    bench.write(make_config(["plate.youngs_modulus"], {"search.n_generation": 1}))
    if "\0" not in name:
        shutil.copy("plate.npz", f"{name}.npz")
    out = {"run": name, "inspect": "out", "simulate": f"{name}.uff"}[verb]
    given = f"{name}.npz" if verb == "inspect" else "truth.yaml" if verb == "simulate" else "plate.yaml"
    status, _, stderr = command(verb, given, "--out", out)
    assert (status, stderr.count("\n")) == (2, 1)
    assert "in UTF-8" in stderr
    assert stderr.startswith(name[:1])
    assert not Path("out").exists()


def test_there_are_eight_dozen_of_them():
    assert len(MISTAKES) >= 115


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["plate.yaml"], "expected a verb before a file, got 'plate.yaml'. Write torchplate run plate.yaml"),
        (["diagnos", "plate.yaml"], "Did you mean 'diagnose'?"),
        (["Run", "plate.yaml"], "Did you mean 'run'?"),
        (["new", "test.uff", "--thickness", "3.1mm"], "without the unit and with a decimal point, got '3.1mm'"),
        (["new", "test.uff", "--thickness", "0,003"], "with a decimal point, got '0,003'"),
        (["run", "plate.yaml", "--seed", "3"], "Write --set search.seed=3."),
        (["run", "plate.yaml", "--n-generation=40"], "Write --set search.n_generation=40."),
        (["run", "plate.yaml", "other.yaml"], "torchplate run takes one config: run them one after the other."),
        (["frf", "hits.uff", "--out", "plate.uff", "--duration", "inf"], "expected a finite number"),
        (["plan", "plate.yaml", "--masses", "nan"], "expected a finite number"),
        (["run", "plate.yaml", "--out", ""], "argument --out: expected a file or a folder, got no text. Name one"),
        (["inspect", " "], "argument file: expected a file or a folder, got no text"),
        (["frf", "", "--out", "a.uff"], "got no text"),
    ],
)
def test_a_mistake_on_the_command_line_gets_its_remedy(arguments, words, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
