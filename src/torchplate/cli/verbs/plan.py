"""`torchplate plan`: the cheapest further test that would tell which name is right, and the config of its state."""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from torchplate.cli.config import InputError
from torchplate.cli.config.build import Run, load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.cli.folder.occupied import occupied
from torchplate.cli.folder.opening import HYPOTHESES, check_free, diagnosis_folder, has_ended, relocated
from torchplate.cli.folder.writing import write_text
from torchplate.cli.machine.device import device_named
from torchplate.cli.progress.console import speaking
from torchplate.cli.results.table import plain_table
from torchplate.cli.verbs.diagnose import diagnose
from torchplate.cli.verbs.plan_text import compose, in_words
from torchplate.diagnosis import Doubt
from torchplate.planning import Lab, Plan
from torchplate.planning import plan as find_next

PLAN, CONFIG = "plan.json", "plan.yaml"
# Of each kind of test so many are shown.
SHOWN = 3


def plan(
    config: Path | str,
    out: Path | None = None,
    overrides: Sequence[str] = (),
    source: Path | None = None,
    lab: Lab | None = None,
    console: Console | None = None,
    force: bool = False,
    device: str = "cpu",
) -> Plan:
    """Score what could be measured next, and write plan.json and plan.yaml.

    Args:
        config: the YAML file that was, or is to be, diagnosed.
        out: the folder; that of the diagnosis if left out.
        overrides: "key.key=value" each.
        source: folder of its diagnosis; left out, the latest of this very config under runs/, else a new one.
        lab: what can be done; everything if left out.
        console: where progress goes.
        force: write over an earlier plan.
        device: where the diagnosis is made, if one is; a plan is made on the CPU.

    Raises:
        InputError: if config, diagnosis or folder cannot be used, or nothing is left to be told apart.
    """
    console = console or speaking()
    recipe = load_run(config, overrides)
    folder = source or _latest(recipe)
    where = out or folder
    if where is not None:
        check_free(where, "plan", force=force)
    if folder is None:
        device_named(device)
        folder = diagnosis_folder(recipe, None, False)
        diagnose(config, folder, overrides, device, console=console)
    where = out or folder
    verdict, doubts = read_doubts(folder)
    if not _is_of(recipe, folder):
        raise InputError(
            f"--from {folder}: Expected a diagnosis of {recipe.path} as it is, got one of another mesh, model or "
            f"measurement. Plan from {folder / 'config.yaml'}, give the same --set, or leave --from out."
        )
    test = plate_test(recipe)
    if test.measurement is None or not doubts:
        raise recipe.error(
            "measurement",
            "Expected FRFs for a plan, got a table of natural frequencies or mode shapes. Measure FRFs, or follow what "
            "the diagnosis says to measure next.",
        )
    if verdict == "unexplained":
        raise InputError(
            f"{folder}: Expected a diagnosis that left names to tell apart, got one that no effect of the catalogue "
            "explains. Do what it says under next_measurements."
        )
    console.print(f"[bold]{escape(recipe.path.stem)}[/]: {in_words(doubts)}", highlight=False, soft_wrap=True)
    measurement = test.measurement
    with occupied(where):
        found = recipe.told(
            "plan",
            lambda: find_next(
                test.model,
                measurement,
                doubts,
                lab=lab,
                tolerance=dict(test.tolerance),
                n_average=test.n_average,
                gain_is_unknown=test.gain_is_unknown,
                imperfections=test.imperfections,
                seed=recipe.config.search.seed,
                say=lambda text: console.print(f"  {text}", style="dim", highlight=False, markup=False),
            ),
        )
        write_text(where / CONFIG, compose(relocated(recipe, where), found))
        content = {"verdict": verdict, **found.to_dict(), "config": CONFIG}
        write_text(where / PLAN, json.dumps(content, indent=1, allow_nan=False) + "\n")
        _say(console, found, where)
    return found


def read_doubts(folder: Path) -> tuple[str, tuple[Doubt, ...]]:
    """The verdict of a diagnosis, and what it left open.

    Raises:
        InputError: if the folder holds no diagnosis, or one without what a plan needs.
    """
    try:
        verdict = json.loads((folder / "diagnosis.json").read_text())["verdict"]
        told = json.loads((folder / HYPOTHESES).read_text())
        return str(verdict), tuple(Doubt.from_dict(one) for one in told["doubts"])
    except FileNotFoundError as error:
        missing = Path(str(error.filename)).name
        raise InputError(
            f"--from {folder}: Expected the folder of a diagnosis, got one without {missing}. Name the folder that "
            "`torchplate diagnose` wrote, or leave --from out to diagnose anew."
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"--from {folder}: Expected diagnosis.json and {HYPOTHESES} as `torchplate diagnose` writes them, got "
            "others. Leave --from out to diagnose anew."
        ) from None


def _latest(recipe: Run) -> Path | None:
    """The latest folder under runs/ with a diagnosis of this very config; None where there is none."""
    for folder in sorted((Path("runs") / recipe.path.stem).glob("*"), reverse=True):
        if has_ended(folder) and (folder / HYPOTHESES).exists() and _is_of(recipe, folder):
            return folder
    return None


def _is_of(recipe: Run, folder: Path) -> bool:
    """Whether what was diagnosed in a folder is what a config says."""
    try:
        past = load_run(folder / "config.yaml").raw
    except InputError:
        return False
    now = relocated(recipe, folder)
    return all(past.get(key) == now.get(key) for key in ("mesh", "effects", "measurement"))


def _say(console: Console, found: Plan, folder: Path) -> None:
    table = plain_table("test", "cost", "right name" if found.needed else "interval", "parts")
    shown: dict[str, int] = {}
    for one in found.scored:
        kind = one.proposal.can
        shown[kind] = shown.get(kind, 0) + 1
        if shown[kind] <= SHOWN:
            value = f"{one.probability:.3f}" if found.needed else f"{one.narrowing:.2f}"
            table.add_row(one.proposal.title, str(one.proposal.cost), value, escape(one.says if found.needed else ""))
    console.print(table)
    first = found.proposed
    if found.needed:
        reach = "" if first.probability >= found.sure else "; no test reaches what counts as sure"
        console.print(
            f"  [bold]{escape(first.proposal.title)}[/]: the right name is expected to have a probability of "
            f"{first.probability:.2f} then{reach}. {escape(first.proposal.instruction)}",
            highlight=False,
        )
    else:
        console.print(
            f"  No further test is needed for the name. What narrows its numbers most: {escape(first.proposal.title)}, "
            f"to {first.narrowing:.2f} times their standard deviations on the mean. "
            f"{escape(first.proposal.instruction)}",
            highlight=False,
        )
    command = f"torchplate diagnose {shlex.quote(str(folder / CONFIG))}"
    console.print(
        f"  Then: put the name of the new file into {folder / CONFIG}, and `{command}`.",
        highlight=False,
        soft_wrap=True,
    )
