"""Draws the cases, lets the diagnosis loose on each in worker processes, and writes down what came of it."""

import json
import os
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import redirect_stdout
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
import yaml
from rich.console import Console
from rich.table import Table

from blind import states
from blind.score import Score, read
from blind.strata import PERFECT, STRATA

# From a config and a folder to a diagnosis in that folder.
Diagnose = Callable[[Path, Path], Any]


def catalogue_diagnosis(config: Path, out: Path) -> None:
    """Torchplate's own diagnosis, without figures; what it says goes to log.txt beside the config."""
    from torchplate.cli.verbs.diagnose import diagnose

    with (config.parent / "log.txt").open("w") as log, redirect_stdout(log):
        reference = config.parent / "reference.yaml"
        diagnose(config, out, report=False, since=reference if reference.exists() else None)


def run_case(
    seed_set: str,
    index: int,
    folder: Path,
    diagnose: Diagnose = catalogue_diagnosis,
    stratum: str = "clean",
    by: str | None = None,
) -> dict[str, Any]:
    """Draw one case, diagnose it, and say what was hidden and what was found; a crash is one more finding.

    Args:
        seed_set: any word.
        index: in the stratum's suite.
        folder: of cases and results.
        diagnose: from a config and a folder to a diagnosis there.
        stratum: which one.
        by: which truth; left out, the stratum's own choice.
    """
    torch.set_num_threads(1)
    case = STRATA[stratum].case(seed_set, index, by)
    own = folder / "cases" / case.name
    config = case.write(own)
    out = own / "diagnosis"
    record: dict[str, Any] = {
        "set": seed_set,
        "stratum": stratum,
        "index": index,
        "truth": case.record(),
        "commit": commit(),
    }
    begin, computed = time.perf_counter(), time.process_time()
    try:
        diagnose(config, out)
        record["diagnosis"] = json.loads((out / "diagnosis.json").read_text())
        model = out / record["diagnosis"].get("model", "model.yaml")
        record["model"] = yaml.safe_load(model.read_text())["effects"] if model.is_file() else {}
        record["youngs_modulus"] = found_modulus(record["model"])
    except (Exception, SystemExit) as error:
        record["diagnosis"] = None
        record["error"] = traceback.format_exception_only(error)[-1].strip()
        (own / "traceback.txt").write_text(traceback.format_exc())
    record["seconds"] = time.perf_counter() - begin
    record["seconds_of_cpu"] = time.process_time() - computed
    return record


def found_modulus(effects: dict[str, dict[str, Any]]) -> float | None:
    """plate.youngs_modulus of a model.yaml's effects; None where there is none or it is not a number [Pa]."""
    plates = [one for one in effects.values() if one.get("effect") == "plate"]
    value: Any = plates[0].get("youngs_modulus") if plates else None
    if isinstance(value, dict):
        value = value.get("value")
    try:
        return float(value) if not isinstance(value, list) else None
    except (TypeError, ValueError):
        return None


def commit() -> str:
    """The commit of the working tree, where git knows it."""
    found = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False, cwd=Path(__file__).parent
    )
    return found.stdout.strip() or "unknown"


def chosen(cases: str, only: str | None, stratum: str = "clean") -> list[int]:
    """Indices of the suite: a slice "0:20", a list "3,17", and only those that hide a name or are of a kind."""
    slots = STRATA[stratum].suite()
    if ":" in cases:
        low, _, high = cases.partition(":")
        indices = list(range(len(slots)))[int(low or 0) : int(high) if high else None]
    else:
        indices = [int(part) for part in cases.split(",")]
    return [i for i in indices if only is None or only in (*slots[i].names, slots[i].kind)]


def run_suite(
    seed_set: str,
    indices: Iterable[int],
    folder: Path,
    n_worker: int,
    diagnose: Diagnose = catalogue_diagnosis,
    stratum: str = "clean",
    by: str | None = None,
) -> None:
    """Run what is not there yet; one line of results.jsonl for each case as soon as it is done."""
    folder.mkdir(parents=True, exist_ok=True)
    results = folder / "results.jsonl"
    done = {record["index"] for record in read(results)} if results.exists() else set()
    missing = [index for index in indices if index not in done]
    os.environ["OMP_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(n_worker, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(run_case, seed_set, index, folder, diagnose, stratum, by): index for index in missing}
        for job in as_completed(jobs):
            try:
                record = job.result()
            except BrokenProcessPool as error:
                # A worker was killed: which case it was cannot be told, so none is written down.
                print(f"A worker died ({error}). Run the same command again.", file=sys.stderr)
                return
            except Exception as error:
                print(f"Case {jobs[job]:03d} could not be drawn: {error!r}", file=sys.stderr)
                continue
            with results.open("a") as file:
                file.write(json.dumps(record) + "\n")
            print(_line(record), flush=True)


def _line(record: dict[str, Any]) -> str:
    """One case in one line."""
    if record["stratum"] == "states":
        return states.line(record)
    found = Score([record]).verdicts[0]
    truth = record["truth"]
    hidden = "+".join(one["effect"] for one in truth["hidden"]) or "nothing"
    if truth.get("detectable"):
        hidden += f" (seen: {' '.join(truth['detectable'])})"
    named = "+".join(found.named) or (record["diagnosis"]["verdict"] if record["diagnosis"] else record["error"])
    mark = "right" if found.right else "wrong"
    return f"{truth['name']} {mark} {truth['kind']} {hidden} -> {named} {found.why} ({record['seconds']:.0f} s)"


def print_draws(seed_set: str, indices: Iterable[int], stratum: str = "clean", by: str | None = None) -> None:
    """A table of the cases, nothing run."""
    # Of perfect tests what is left over the noise, of the others the expected fall of −2 log likelihood.
    left = "left / noise" if stratum in PERFECT else "fall, seen"
    table = Table("case", "kind", "hidden", "noise %", left, "FRFs", "lines", "by", "known", "s")
    for index in indices:
        begin = time.perf_counter()
        case = STRATA[stratum].case(seed_set, index, by)
        record = case.record()
        table.add_row(
            case.name,
            case.kind,
            "; ".join(_words(one) for one in record["hidden"])
            + "".join(f" {k}={v:.3g}" for k, v in case.extra.items()),
            f"{100 * case.noise:.2f}",
            " ".join(f"{shows / case.noise:.1f}" for shows in case.shows)
            if stratum in PERFECT
            else " ".join(f"{fall:.3g} {word}" for fall, word in zip(case.shows, case.detectable, strict=True)),
            str(record["n_frf"]),
            str(record["n_line"]),
            record["by"],
            " ".join(record["known"]),
            f"{time.perf_counter() - begin:.2f}",
        )
    Console(width=200).print(table)


def _words(hidden: dict[str, Any]) -> str:
    numbers = " ".join(f"{name}={value:.3g}" for name, value in hidden["parameters"].items())
    return f"{hidden['effect']} {numbers} {hidden['options'] or ''}".strip()
