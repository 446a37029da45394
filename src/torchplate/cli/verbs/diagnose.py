"""`torchplate diagnose`: where model and measurement disagree, the effect that is missing, and the model with it."""

import json
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from torchplate.cli.config import dump
from torchplate.cli.config.build import Run, load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.cli.folder.descents import DescentFile, depends_on
from torchplate.cli.folder.occupied import occupied
from torchplate.cli.folder.opening import DESCENTS, HYPOTHESES, check_free, diagnosis_folder, open_folder, relocated
from torchplate.cli.folder.writing import write_files, write_text
from torchplate.cli.machine.allocator import keep_freed_memory
from torchplate.cli.machine.device import device_named, on_cpu_alone
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.table import plain_table
from torchplate.cli.verbs.diagnose_change import diagnose_change
from torchplate.diagnosis import FIRST_REFIT, Diagnosis
from torchplate.diagnosis import SCHEMA as OF_HYPOTHESES
from torchplate.diagnosis import diagnose as find_missing
from torchplate.discrepancy import ModalEvidence
from torchplate.effects import options
from torchplate.notation import drop, percent
from torchplate.search import Recall, recalling

MODEL = "model.yaml"
VERDICTS = {
    "consistent": "Nothing is missing: the model explains the measurement to its noise.",
    "explained": "What was missing is named below; with it the model explains the measurement to its noise.",
    "partly_explained": "What is named below explains a part; something else is missing.",
    "unexplained": "Something is missing, and no effect of the catalogue accounts for it.",
}


CHANGES = {
    "consistent": "Nothing changed that shows above noise, imperfections and the drift from test to test.",
    "explained": "What is named below explains the difference between the tests.",
    "partly_explained": "What is named below explains a part of the difference; something else changed.",
    "unexplained": "Something changed, and nothing that was tried accounts for it.",
}


def diagnose(
    config: Path | str,
    out: Path | None = None,
    overrides: Sequence[str] = (),
    device: str = "cpu",
    report: bool = True,
    console: Console | None = None,
    force: bool = False,
    resume: bool = False,
    since: Path | str | None = None,
) -> Diagnosis:
    """Diagnose a config's model, or what changed since a reference; write diagnosis.json, model.yaml and the report.

    Args:
        config: the YAML file; its intervals are fitted, its numbers are taken as known, those with a std as known so
            well.
        out: the folder; `runs/<config name>/<time>` if left out.
        overrides: "key.key=value" each.
        device: what was asked for; all is done on the CPU, and said.
        report: whether to write report.md, report.html and the TensorBoard log.
        console: where progress goes.
        force: write over what an earlier diagnosis has left in `out`.
        resume: go on from the last descent that was kept in `out`, or in the config's latest folder under runs/.
        since: the config of a reference test; where the config holds several states, its first one is.

    Raises:
        InputError: if the config, the measurement, the device or the folder cannot be used, or there is nothing to
            resume.
    """
    console = console or speaking()
    keep_freed_memory()
    recipe = load_run(config, overrides)
    device_named(device)
    if since is not None or recipe.states:
        if resume:
            raise recipe.error(
                "--resume", "Expected a diagnosis of one test, got one of what has changed. Leave --resume out."
            )

        def written(run: Run, found: Diagnosis, where: Path) -> None:
            write(run, found, where, report, f"{config}{f' --since {since}' if since is not None else ''}")
            _say(console, found, where, CHANGES)

        return diagnose_change(config, since, out, overrides, device, console, force, written)
    folder = diagnosis_folder(recipe, out, resume)
    check_free(folder, "diagnose", force=force, resume=resume)
    paired: list[str] = []
    test = plate_test(recipe, paired.append)
    kept = DescentFile(folder / DESCENTS, depends_on(recipe, "cpu"))
    past = kept.read() if resume else []
    with occupied(folder):
        open_folder(recipe, folder, "cpu", "diagnose", force=force, resume=resume)
        on_cpu_alone(device, "A diagnosis", console)
        console.print(f"[bold]{escape(recipe.path.stem)}[/]")
        if resume:
            what = f"{len(past)} descents are taken over" if past else "nothing was kept: the diagnosis begins anew"
            console.print(f"  From {folder}: {what}.", highlight=False, markup=False, soft_wrap=True)
        for line in (*(f"Note: {note}" for note in recipe.remarks(test.model)), *paired):
            console.print(f"  {line}", markup=False, highlight=False, soft_wrap=True)
        with recalling(Recall(past, kept.keep)):
            found = find_missing(
                test.model,
                test.measurement,
                test.natural_frequencies,
                tolerance=dict(test.tolerance),
                n_average=test.n_average,
                gain_is_unknown=test.gain_is_unknown,
                imperfections=test.imperfections,
                seed=recipe.config.search.seed,
                say=lambda text: console.print(f"  {text}", style="dim", highlight=False, markup=False),
            )
        write(recipe, found, folder, report, shlex.quote(str(config)), recipe.modal_evidence(test.model))
        # There is nothing more to go on from.
        (folder / DESCENTS).unlink(missing_ok=True)
        _say(console, found, folder)
        if any(one.equivalent for one in found.effects) and found.doubts:
            said = (
                f"Next: `torchplate plan {shlex.quote(str(config))}` scores what further tests would tell of the name."
            )
            console.print(f"  {said}", highlight=False, markup=False, soft_wrap=True)
        return found


def write(
    recipe: Run, found: Diagnosis, folder: Path, report: bool, command: str, modal: ModalEvidence | None = None
) -> None:
    """model.yaml, hypotheses.json, if wanted what people read, and diagnosis.json."""
    write_text(folder / MODEL, dump(_updated(recipe, found, folder)))
    if report:
        from torchplate.cli.progress.log import log_diagnosis
        from torchplate.report import diagnosis_report

        command = f"torchplate diagnose {command}"
        write_files(folder, diagnosis_report(recipe.path.stem, found, folder, command, modal))
        log_diagnosis(folder, found)
    hypotheses = {"schema": OF_HYPOTHESES, "doubts": [one.to_dict() for one in found.doubts]}
    write_text(folder / HYPOTHESES, json.dumps(_plain(hypotheses), indent=1, allow_nan=False) + "\n")
    # Last: a folder that holds it holds everything.
    content = found.to_dict() | {"model": MODEL}
    write_text(folder / "diagnosis.json", json.dumps(_plain(content), indent=1, allow_nan=False) + "\n")


def _updated(recipe: Run, found: Diagnosis, folder: Path) -> dict[str, Any]:
    """The config with the effects added, every value a number."""
    raw = relocated(recipe, folder)
    effects: dict[str, Any] = {label: dict(body) for label, body in raw["effects"].items()}
    by_label: dict[str, dict[str, float]] = {}
    known = found.model.known_values
    for name, one in found.parameters.items():
        label, _, key = name.rpartition(".")
        # Beside a field the numbers are others than those that were told of the model without one.
        by_label.setdefault(label, {})[key] = known.get(name, one.value) if found.field is not None else one.value
    for label, effect in found.model.effects.items():
        own = {name: getattr(effect, name) for name in options(type(effect)) if getattr(effect, name)}
        effects.setdefault(label, {"effect": effect.name, **_plain(own)})
    for named in found.effects:
        # What went away since a reference has no numbers in the model.
        if named.label in by_label or not named.parameters:
            effects.setdefault(named.label, {"effect": named.name, **_plain(named.options)})
    for label, values in by_label.items():
        effects[label] |= values
    raw["effects"] = effects
    # FRFs are diagnosed on a finer mesh whose error is taken off, whether or not that was worth a name; a table may
    # have been found to come from the given one.
    extrapolated = found.model.assembly.correction is not None or found.model.mesh.extrapolate
    split = math.prod(
        int(body.get("refine", 2)) for body in effects.values() if body["effect"] == "mesh_discretisation"
    )
    raw["mesh"] = dict(raw["mesh"]) | {"refine": found.model.mesh.refine // split, "extrapolate": extrapolated}
    # An edge that was held may yield now.
    raw["mesh"] |= {"edges": dict(found.model.mesh.edges)}
    raw["search"] = {key: value for key, value in dict(raw.get("search", {})).items() if key == "seed"}
    return raw


def _plain(value: Any) -> Any:
    """What JSON and YAML hold: no tuples, no NaN."""
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and value != value:
        return None
    return value


def _say(console: Console, found: Diagnosis, folder: Path, words: Mapping[str, str] = VERDICTS) -> None:
    console.print(f"  [bold]{found.verdict}[/]: {words[found.verdict]}")
    for effect in found.effects:
        console.print(f"  {effect.evidence} Confidence {effect.confidence:.2f}.", highlight=False, markup=False)
    gap = found.gap
    held = (
        ""
        if gap.heldout_final is None
        else f" (held-out FRFs {percent(gap.heldout_baseline)} to {percent(gap.heldout_final)})"
    )
    console.print(
        f"  gap {percent(gap.baseline)} to {percent(gap.final)}{held}; noise floor {percent(gap.noise_floor)}"
    )
    if found.scores:
        table = plain_table("effect", "expected drop", "gap at first refit", "", whole=True)
        for row in found.scores[0]:
            table.add_row(
                row.name,
                drop(row.expected_drop),
                percent(row.gap),
                escape(row.remark),
            )
        console.print(table)
        if any(row.gap is not None for row in found.scores[0]):
            console.print(f"  {FIRST_REFIT}", style="dim", highlight=False)
    if found.field is not None:
        for sentence in found.field.sentences:
            console.print(f"  Field: {sentence}", highlight=False, markup=False)
    for sentence in (*found.missing, *found.remarks):
        console.print(f"  [yellow]Note:[/] {escape(sentence)}", highlight=False)
    for sentence in found.next_measurements:
        console.print(f"  Next: {sentence}", highlight=False, markup=False)
    console.print(f"  Results: {folder}", markup=False, soft_wrap=True)
