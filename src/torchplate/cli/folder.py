"""The folder of a run: where it is, what is written before the search, and what a search goes on from."""

import json
import os
import platform
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from torchplate.cli.build import Run, load_run
from torchplate.cli.config import InputError, dump
from torchplate.search import Checkpoint, LeastSquares

PACKAGES = ("torchplate-fem", "torch", "numpy", "scipy", "pyuff", "pydantic", "tensorboard", "matplotlib")


def open_folder(recipe: Run, folder: Path, device: str) -> None:
    """Make the folder, and write the config as it is run and the versions it is run with."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "config.yaml").write_text(dump(relocated(recipe, folder)))
    (folder / "versions.json").write_text(json.dumps(_versions(device), indent=1) + "\n")


def run_folder(recipe: Run, out: Path | None, resume: bool) -> Path:
    """`out`, else a new folder named by the config and the time, else, to resume, the config's latest.

    Raises:
        InputError: if `out` is a file, the search keeps no checkpoints, or there is no folder to resume.
    """
    if resume and isinstance(recipe.optimizer(), LeastSquares):
        raise recipe.error(
            "--resume",
            "Expected a search that keeps checkpoints, got least_squares, which keeps none. Leave --resume out: the "
            "same seed repeats it from the start.",
        )
    if out is not None:
        if Path(out).is_file():
            raise InputError(f"--out {out}: Expected a folder, got a file. Name another place.")
        return Path(out)
    home = Path("runs") / recipe.path.stem
    if not resume:
        return home / time.strftime("%Y-%m-%d_%H-%M-%S")
    past = sorted(folder.parent for folder in home.glob("*/checkpoint.pt"))
    if not past:
        raise InputError(
            f"{recipe.path}: --resume: Expected a checkpoint under {home}, found none. Leave --resume out."
        )
    return past[-1]


def read_checkpoint(recipe: Run, folder: Path, device: torch.device) -> Checkpoint:
    """The checkpoint of an interrupted run, which this config must be able to go on from on this device.

    Raises:
        InputError: if there is none, it is broken, or it is that of another search or another kind of device.
    """
    path = folder / "checkpoint.pt"
    if not path.exists():
        raise InputError(f"{recipe.path}: --resume: Expected a checkpoint at {path}, found none. Leave --resume out.")
    try:
        checkpoint: Checkpoint = torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # whatever torch says of a file that is no checkpoint
        raise recipe.error("--resume", f"Expected a checkpoint in {path}, got another file. Run anew.") from error
    past = load_run(folder / "config.yaml")
    for key, before, now in zip(_IDENTITY, _identity(past), _identity(recipe), strict=True):
        if before != now:
            raise recipe.error(
                f"--resume: {key}", f"Expected the checkpoint's, {before}, got {now}. Set it back, or run anew."
            )
    try:
        torch.Generator(device).set_state(checkpoint["generator"])
    except RuntimeError as error:
        raise recipe.error(
            "--resume",
            f"Expected the kind of device that made {path}, whose random numbers no other one goes on with, got "
            f"{device.type}. Give it as --device, or run anew.",
        ) from error
    return checkpoint


# What a checkpoint cannot go on without; budgets, and where the measurement lies, may change.
_SEARCH = ("seed", "n_repeat", "basis", "precision")
_IDENTITY = ("search", *(f"search.{name}" for name in _SEARCH), "mesh", "effects", "objective", "measurement")


def _identity(recipe: Run) -> tuple[Any, ...]:
    config, search = recipe.config, recipe.config.search
    measurement = config.measurement.model_copy(update={"file": None})
    own = recipe.optimizer(), *(getattr(search, name) for name in _SEARCH)
    return *own, config.mesh, config.effects, config.objective, measurement


def relocated(recipe: Run, folder: Path) -> dict[str, Any]:
    """The config as it was run, overrides included; the measurement's path as seen from the run's folder."""
    raw = dict(recipe.raw)
    if recipe.config.measurement.file is not None:
        file = (recipe.path.parent / recipe.config.measurement.file).resolve()
        seen = os.path.relpath(file, folder.resolve())
        raw["measurement"] = dict(raw["measurement"]) | {"file": seen}
    return raw


def _versions(device: str) -> dict[str, Any]:
    packages = {name: version(name) for name in PACKAGES}
    machine = {"python": platform.python_version(), "platform": platform.platform(), "device": device}
    shared = {"n_thread": torch.get_num_threads(), "n_process": int(os.environ.get("WORLD_SIZE", 1))}
    return machine | shared | packages
