"""The folder of a run: where it is, what is written first and never over, and what a search goes on from."""

import json
import os
import platform
import time
from pathlib import Path
from typing import Any

import torch

from torchplate.cli.config import InputError, dump
from torchplate.cli.config.build import Run, load_run
from torchplate.cli.folder.checkpoint import fault
from torchplate.cli.folder.writing import FORCE, write_text
from torchplate.cli.machine.installed import version_of
from torchplate.search import Checkpoint, LeastSquares, Optimizer

PACKAGES = ("torchplate-fem", "torch", "numpy", "scipy", "pyuff", "pydantic", "tensorboard", "matplotlib")
CHECKPOINT = "checkpoint.pt"
DESCENTS = "descents.pt"
HYPOTHESES = "hypotheses.json"

# What each verb leaves, and does not write over unasked.
PRODUCTS = {
    "run": ("result.json", "report.md", "report.html", "checkpoint.pt"),
    "diagnose": ("diagnosis.json", "model.yaml", "report.md", "report.html", HYPOTHESES, DESCENTS),
    "plan": ("plan.json", "plan.yaml"),
}


def open_folder(
    recipe: Run, folder: Path, device: str, verb: str, *, force: bool = False, resume: bool = False
) -> None:
    """Write the config as it is run and the versions it is run with.

    Args:
        recipe: what is run.
        folder: where; it is there, and this process alone works in it.
        device: where the tensors live.
        verb: a key of PRODUCTS.
        force: take away what an earlier run has left, so that its result never lies beside this one's config.
        resume: leave it, to go on from.

    Raises:
        InputError: if an earlier run has left something, and neither is said.
    """
    check_free(folder, verb, force=force, resume=resume)
    if force and not resume:
        for name in PRODUCTS[verb]:
            (folder / name).unlink(missing_ok=True)
    write_text(folder / "config.yaml", dump(relocated(recipe, folder)))
    write_text(folder / "versions.json", json.dumps({"verb": verb} | _versions(device), indent=1) + "\n")


def check_free(folder: Path, verb: str, *, force: bool = False, resume: bool = False) -> None:
    """Whether a verb may write here.

    Raises:
        InputError: if an earlier run has left something that this one would write over.
    """
    if force or resume:
        return
    for name in PRODUCTS[verb]:
        if (folder / name).exists():
            on = "" if verb == "plan" else " or --resume to go on from it"
            raise InputError(
                f"--out {folder}: Expected a folder without results, got one that holds {name}. Name another, or give "
                f"{FORCE} to write over it{on}."
            )


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
    if out is not None or not resume:
        return _new_folder(recipe, out)
    home = Path("runs") / recipe.path.stem
    past = sorted(folder for folder in home.glob("*") if (folder / CHECKPOINT).exists() or _has_begun(folder, "run"))
    if not past:
        raise InputError(
            f"{recipe.path}: --resume: Expected a checkpoint under {home}, found none. Leave --resume out."
        )
    return past[-1]


def diagnosis_folder(recipe: Run, out: Path | None, resume: bool) -> Path:
    """The same for a diagnosis, which goes on where one was stopped before it had written all it found.

    Raises:
        InputError: if `out` is a file, or there is no diagnosis to go on with.
    """
    if not resume:
        return _new_folder(recipe, out)
    home = Path("runs") / recipe.path.stem
    places = [Path(out)] if out is not None else sorted(home.glob("*"))
    past = [folder for folder in places if (folder / DESCENTS).exists() or _has_begun(folder, "diagnose")]
    if not past:
        where = f"in {out}" if out is not None else f"under {home}"
        raise InputError(
            f"{recipe.path}: --resume: Expected a diagnosis {where} that was stopped, found none. Leave --resume out."
        )
    return past[-1]


def has_ended(folder: Path) -> bool:
    """Whether a diagnosis has written all it found here."""
    return (folder / "diagnosis.json").exists() and not (folder / DESCENTS).exists()


def _new_folder(recipe: Run, out: Path | None) -> Path:
    """`out`, else a new folder named by the config and the time.

    Raises:
        InputError: if `out` is a file.
    """
    if out is not None:
        if Path(out).is_file():
            raise InputError(f"--out {out}: Expected a folder, got a file. Name another place.")
        return Path(out)
    home = Path("runs") / recipe.path.stem
    name = time.strftime("%Y-%m-%d_%H-%M-%S")
    taken = sum(1 for _ in home.glob(f"{name}*"))
    return home / (f"{name}_{taken + 1}" if taken else name)


def _has_begun(folder: Path, verb: str) -> bool:
    """Whether something was begun here that was stopped before it had left anything to go on from."""
    last = ("diagnosis.json",) if verb == "diagnose" else PRODUCTS[verb]
    if any((folder / name).exists() for name in last):
        return False
    try:
        return bool(json.loads((folder / "versions.json").read_text())["verb"] == verb)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def read_checkpoint(recipe: Run, folder: Path, device: torch.device, n_dimension: int) -> Checkpoint | None:
    """The checkpoint of an interrupted run, which this config must be able to go on from on this device.

    Returns:
        It; None where the run was stopped before it had written one.

    Raises:
        InputError: if there was no run, the checkpoint is broken, or it is that of another search or another kind of
            device.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        if _has_begun(folder, "run"):
            return None
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
    if (wrong := fault(checkpoint, _population_search(recipe), recipe.config.search.n_repeat, n_dimension)) is not None:
        raise recipe.error("--resume", f"Expected a checkpoint of this search in {path}, got {wrong}. Run anew.")
    try:
        torch.Generator(device).set_state(checkpoint["generator"])
    except (RuntimeError, TypeError) as error:
        raise recipe.error(
            "--resume",
            f"Expected the kind of device that made {path}, whose random numbers no other one goes on with, got "
            f"{device.type}. Give it as --device, or run anew.",
        ) from error
    return checkpoint


def _population_search(recipe: Run) -> Optimizer[Any]:
    optimizer = recipe.optimizer()
    assert not isinstance(optimizer, LeastSquares)  # which `run_folder` has refused
    return optimizer


# What a checkpoint cannot go on without; budgets, and where the measurement lies, may change.
_SEARCH = ("seed", "n_repeat", "basis", "precision")
_IDENTITY = ("search", *(f"search.{name}" for name in _SEARCH), "mesh", "effects", "objective", "measurement")


def _identity(recipe: Run) -> tuple[Any, ...]:
    config, search = recipe.config, recipe.config.search
    measurement = config.measurement.model_copy(update={"file": None, "nodes": None})
    own = recipe.optimizer(), *(getattr(search, name) for name in _SEARCH)
    return *own, config.mesh, config.effects, config.objective, measurement


def relocated(recipe: Run, folder: Path) -> dict[str, Any]:
    """The config as it was run, overrides included; the measurement's paths as seen from the run's folder."""
    raw = dict(recipe.raw)
    if recipe.states:
        items = zip(raw["measurement"], recipe.states, strict=True)
        raw["measurement"] = [
            dict(item) | {key: value for key, value in relocated(one.run, folder)["measurement"].items() if key in item}
            for item, one in items
        ]
        return raw
    for key in ("file", "nodes"):
        given = getattr(recipe.config.measurement, key)
        if given is not None:
            seen = os.path.relpath((recipe.path.parent / given).resolve(), folder.resolve())
            raw["measurement"] = dict(raw["measurement"]) | {key: seen}
    if (modal := recipe.config.measurement.modal_model) is not None:
        seen = os.path.relpath((recipe.path.parent / modal.file).resolve(), folder.resolve())
        moved = dict(raw["measurement"]["modal_model"]) | {"file": seen}
        raw["measurement"] = dict(raw["measurement"]) | {"modal_model": moved}
    return raw


def _versions(device: str) -> dict[str, Any]:
    packages = {name: version_of(name) for name in PACKAGES}
    machine = {"python": platform.python_version(), "platform": platform.platform(), "device": device}
    shared = {"n_thread": torch.get_num_threads(), "n_process": int(os.environ.get("WORLD_SIZE", 1))}
    return machine | shared | packages
