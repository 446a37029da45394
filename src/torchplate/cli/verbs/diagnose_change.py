"""`torchplate diagnose --since`, and where `measurement` is a list: what has changed between tests of one plate."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from torchplate.cli.config.build import Run, load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.cli.folder.occupied import occupied
from torchplate.cli.folder.opening import check_free, diagnosis_folder, open_folder
from torchplate.cli.machine.device import on_cpu_alone
from torchplate.diagnosis import Diagnosis, what_changed

Write = Callable[[Run, Diagnosis, Path], None]


def diagnose_change(
    config: Path | str,
    since: Path | str | None,
    out: Path | None,
    overrides: Sequence[str],
    device: str,
    console: Console,
    force: bool,
    write: Write,
) -> Diagnosis:
    """Diagnose what has changed, and write diagnosis.json, model.yaml and the report for every later test.

    Args:
        config: of the test after; or of several states, of which the first is the reference of the others.
        since: of the reference test; None where the config holds several states.
        out: the folder; with several later states each has one of its own in it, and the last is in the folder too.
        overrides: "key.key=value" each, of `config`.
        device: what was asked for; all is done on the CPU.
        console: where progress goes.
        force: write over what an earlier diagnosis has left.
        write: writes one diagnosis.

    Returns:
        That of the last test.

    Raises:
        InputError: if a config, a measurement or the folder cannot be used.
    """
    recipe = load_run(config, overrides)
    before, later = _tests(recipe, since)
    folder = diagnosis_folder(recipe, out, resume=False)
    check_free(folder, "diagnose", force=force)
    reference = plate_test(before[1], name=before[0])
    found: Diagnosis | None = None
    with occupied(folder):
        open_folder(recipe, folder, "cpu", "diagnose", force=force)
        on_cpu_alone(device, "A diagnosis", console)
        console.print(f"[bold]{escape(recipe.path.stem)}[/] since {escape(before[0])}")

        def say(text: str) -> None:
            console.print(f"  {text}", style="dim", highlight=False, markup=False)

        for name, run, own in later:
            for note in run.remarks(run.model_as_given()):
                console.print(f"  Note: {note}", markup=False, highlight=False, soft_wrap=True)
            test = plate_test(run, name=name)
            seed = recipe.config.search.seed
            found = run.told("measurement", lambda: what_changed(reference, test, own=own, seed=seed, say=say))  # noqa: B023
            if len(later) > 1:
                (folder / name).mkdir(exist_ok=True)
                write(run, found, folder / name)
        assert found is not None
        write(later[-1][1], found, folder)
    return found


def _tests(recipe: Run, since: Path | str | None) -> tuple[tuple[str, Run], list[tuple[str, Run, tuple[str, ...]]]]:
    """The reference, and the tests after it with what is their own."""
    if since is not None:
        if recipe.states:
            raise recipe.error(
                "measurement",
                "Expected one measurement with --since, got a list of states, whose first is the reference. Leave one "
                "of the two out.",
            )
        past = load_run(since)
        if past.states:
            raise past.error(
                "measurement", "Expected one measurement in the reference of --since, got a list of states. Give one."
            )
        return (past.path.stem, past), [(recipe.path.stem, recipe, ())]
    first, *others = recipe.states
    own = set(first.own)
    return (first.name, first.run), [(one.name, one.run, tuple(own | set(one.own))) for one in others]
