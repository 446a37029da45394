"""A small plate that is not square, its exact FRFs in a file, and a short way to run configs on them."""

import copy
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
import torch
from rich.console import Console

from torchplate.cli.config.build import load_model
from torchplate.cli.main import main
from torchplate.cli.results.found import Found
from torchplate.cli.verbs.run import run
from torchplate.measurement import SI_UNIT, Channel, Measurement
from torchplate.report import run as run_report

# What the plate is, and the intervals it lies in.
TRUTH: dict[str, Any] = {
    "plate.youngs_modulus": 2.04e11,
    "wires.stiffness": 1310.0,
    "wires.viscous_damping": 0.83,
    "loss.stiffness_loss_factor": 6.2e-3,
}
INTERVALS: dict[str, Any] = {
    "plate.youngs_modulus": [1.5e11, 2.6e11],
    "wires.stiffness": [700.0, 2000.0],
    "wires.viscous_damping": [0.2, 1.5],
    "loss.stiffness_loss_factor": [1.0e-3, 1.2e-2],
}
BASE: dict[str, Any] = {
    "mesh": {"length_x": 0.41, "length_y": 0.29, "n_x": 3, "n_y": 2},
    "measurement": {"file": "plate.npz", "band": [8.0, 400.0]},
    "effects": {
        "plate": {"effect": "plate", "poisson_ratio": 0.31, "density": 7700.0, "thickness": 0.0031},
        "wires": {"effect": "support_spring", "nodes": [2, 5, 11]},
        "loss": {"effect": "hysteretic_damping"},
    },
    # A strategy that settles in few generations; the paper's own is held against SciPy in tests/search.
    "search": {
        "optimizer": "differential_evolution",
        "strategy": "best/1/bin",
        "n_member": 10,
        "differential_weight": 0.6,
        "crossover_rate": 0.9,
        "n_generation": 5,
        "seed": 4,
        "basis": "full",
    },
    "log": {"n_figure": 0},
}
# As `make check` asks: see tests/conftest.py.
EVERY_CALL = "CHECKED_CALLS" in os.environ
PICTURES = run_report._pictures
PNG = b"\x89PNG\r\n\x1a\n"
RESPONSE, REFERENCE = (4, 7), (1, 6, 10)


def config(searched: Sequence[str] = (), changes: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The base config with these parameters searched and the rest true; `changes` maps "key.key" to a value.

    A change to `...` takes the key away.
    """
    whole = copy.deepcopy(BASE)
    for key, value in TRUTH.items():
        label, name = key.split(".")
        whole["effects"][label][name] = INTERVALS[key] if key in searched else value
    for key, value in (changes or {}).items():
        *parents, last = key.split(".")
        target = whole
        for parent in parents:
            target = target.setdefault(parent, {})
        if value is ...:
            del target[last]
        else:
            target[last] = copy.deepcopy(value)
    return whole


def measurement(path: Path, gain: float = 1.0, kind: str = "accelerance") -> Measurement:
    """What the model of a config says at lines up to 400 Hz, as a measurement without any error."""
    model = load_model(path)
    frequency = torch.linspace(2.0, 400.0, 61, dtype=torch.float64)
    theta = model.known.new_zeros(0)
    if kind == "transmissibility":
        response, reference = (3, 8), (1,)
        frf = model.frf(theta, frequency, list(response), kind=kind)
    else:
        response, reference = RESPONSE, REFERENCE
        frf = model.frf(theta, frequency, list(response), list(reference), kind)
    return Measurement(
        frequency=frequency,
        frf=gain * frf,
        measured=torch.ones(frf.shape[1:], dtype=torch.bool),
        response=tuple(Channel(node) for node in response),
        reference=tuple(Channel(node) for node in reference),
        kind=kind,  # type: ignore[arg-type]
        unit=SI_UNIT[kind],  # type: ignore[index]
    )


@dataclass
class Bench:
    """A folder with configs, measurements and runs."""

    folder: Path

    def write(self, content: Mapping[str, Any] | str, name: str = "plate.yaml") -> Path:
        """A config file; a mapping is written as JSON, which is YAML."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content))
        return path

    def measure(self, changes: Mapping[str, Any] | None = None, gain: float = 1.0, kind: str = "accelerance") -> None:
        """Write plate.npz from the true plate."""
        truth = self.write(config(changes={"measurement": {}, **(changes or {})}), "truth.yaml")
        measurement(truth, gain, kind).to_npz(self.folder / "plate.npz")

    def run(
        self,
        searched: Sequence[str] = (),
        changes: Mapping[str, Any] | None = None,
        out: str = "out",
        overrides: Sequence[str] = (),
        resume: bool = False,
    ) -> Found:
        """One run of the base config."""
        path = self.write(config(searched, changes))
        return run(path, self.folder / out, overrides, resume=resume, console=Console(file=StringIO()), force=True)


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The true plate's config and measurement."""
    bench = Bench(tmp_path_factory.mktemp("measured"))
    bench.measure()
    return {path.name: path.read_bytes() for path in bench.folder.iterdir()}


@pytest.fixture
def bench(measured: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """An empty bench with the true plate's measurement; its runs make no figures; `make check` makes them, unrendered.

    Figures take most of the time of a run as small as these; with `drawn` they are made, `finished` makes and renders
    its own, and monkeypatch.undo() brings both back.
    """
    if not EVERY_CALL:
        monkeypatch.setattr("torchplate.report.run._pictures", lambda *_: ({}, {}))
    monkeypatch.setattr("torchplate.report.run.png", lambda *_: PNG)
    monkeypatch.setattr("torchplate.report.forms.page._picture", lambda _: "")
    for name, content in measured.items():
        (tmp_path / name).write_bytes(content)
    return Bench(tmp_path)


@pytest.fixture
def drawn(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The runs of the bench make their figures, and do not render them."""
    monkeypatch.setattr("torchplate.report.run._pictures", PICTURES)


@pytest.fixture(scope="session")
def truth() -> dict[str, float]:
    return TRUTH


@pytest.fixture(scope="session")
def make_config() -> Callable[..., dict[str, Any]]:
    return config


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """The command line: exit status, stdout, stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


class Finished:
    """A virtual test made by `simulate`, and what DE and ABC found in it; made once for all tests."""

    searches = {
        "de": (),
        # A cycle of 6 sources costs as much as a generation of 12 members.
        "abc": ("search={optimizer: artificial_bee_colony, n_member: 6, n_generation: 40, seed: 3}",),
    }
    searched = ("plate.youngs_modulus", "wires.viscous_damping")

    def __init__(self, folder: Path) -> None:
        bench = Bench(folder)
        # Damping that ends the record's ringing, so that the FRFs carry no leakage; the mesh of the test is that of the
        # identification, so that the truth is found and not what stands in for the mesh error.
        air = {"effects.air": {"effect": "viscous_damping", "mass_coefficient": 20.0}}
        analyser = {"like": "sr785", "n_line": 400, "exponential_window": None, "force_window": None, "bits": None}
        analyser |= {"noise_floor": [0.0, 0.0], "n_pre_trigger": 16, "n_average": 1}
        modal_test = {
            "analyser": analyser,
            "response": [4],
            "reference": [1, 6, 10],
            "refine": 1,
            "extrapolate": False,
            "seed": 5,
        }
        simulated = config(changes=air | {"modal_test": modal_test, "measurement": {}})
        self.simulated = bench.write(simulated, "truth.yaml")
        self.simulate_status = main(["simulate", str(self.simulated), "--out", str(folder / "test.uff")])
        changes = air | {"measurement.file": "../test.uff", "measurement.band": [20.0, 390.0]}
        changes |= {"search.n_generation": 30, "search.basis": "auto", "log.n_figure": 1}
        self.path = bench.write(config(self.searched, changes), "configs/plate.yaml")
        self.found = {
            name: run(
                self.path,
                folder / "runs" / name,
                (*overrides, "search.stagnation=25"),
                console=Console(file=StringIO()),
            )
            for name, overrides in self.searches.items()
        }


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    return Finished(tmp_path_factory.mktemp("finished"))
