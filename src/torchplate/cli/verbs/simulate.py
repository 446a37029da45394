"""`torchplate simulate`: a virtual hammer test of a config's model, written as the analyser would write it."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.config.build import Run, load_run
from torchplate.cli.folder.writing import asked_for
from torchplate.cli.progress.console import speaking
from torchplate.measurement import ANALYSERS, FRF_SUFFIX, Analyser, Hammer, Measurement, write_uff
from torchplate.measurement import simulate as hit
from torchplate.model import PlateModel
from torchplate.notation import counted
from torchplate.search import unknown_name


def simulate(
    path: Path | str,
    out: Path,
    overrides: Sequence[str] = (),
    console: Console | None = None,
    *,
    force: bool = False,
) -> Measurement:
    """Hit the model of a config as `modal_test` says, and write what the analyser shows.

    The plate that is hit has the config's numbers on a mesh `modal_test.refine` times as fine, so that whoever
    identifies it meets the mesh error of a real plate. Responses and references are those of `modal_test`, else of
    `measurement`, else node 3 and every labelled node, as in the paper. What the test is not perfect in is drawn from
    `measurement.position_std` and so on with `modal_test.seed`; what is 0 or left out there is perfect.

    Args:
        path: the YAML file; it must hold numbers only.
        out: the file to write; its suffix says how: .uff, .unv or .npz.
        overrides: "key.key=value" each.
        console: where the closing line goes.
        force: write over another file of that name.

    Raises:
        InputError: if the config holds an interval, something in it cannot be used, or `out` holds something else.
    """
    console = console or speaking()
    out = Path(out)
    if out.suffix not in FRF_SUFFIX:
        raise InputError(
            f"--out {out}: Expected a name that ends in {', '.join(FRF_SUFFIX)}, got '{out.suffix}'. Rename it."
        )
    recipe = load_run(path, overrides)
    settings = recipe.config.modal_test
    model = recipe.told("effects", lambda: recipe.model(refine=settings.refine))
    if model.names:
        raise recipe.error(
            f"effects.{model.names[0]}",
            "Expected a number, since a test needs one plate, got an interval. Give the true value, by --set say.",
        )
    response, reference = _points(recipe, model)
    analyser, hammer = _analyser(recipe), _hammer(recipe)
    # What is tested has no mesh: else whoever refines the model finds the error of this one.
    imperfections = recipe.imperfections()
    measurement = recipe.told(
        "modal_test",
        lambda: hit(
            model,
            response=response,
            reference=reference,
            analyser=analyser,
            hammer=hammer,
            kind=settings.kind,
            imperfections=imperfections,
            without_mesh=settings.extrapolate,
            seed=settings.seed,
        ),
    )
    with asked_for(out, force=force) as partial:
        if out.suffix == ".npz":
            measurement.to_npz(partial)
        else:
            write_uff(measurement, partial)
    cells = " × ".join(str(number) for number in model.mesh.cells)
    made = counted(len(measurement.pairs), "FRF")
    console.print(f"{made} ({measurement.kind}) of a {cells} mesh: {out}", markup=False, soft_wrap=True)
    return measurement


def _points(recipe: Run, model: PlateModel) -> tuple[list[int | tuple[float, float]], list[int | tuple[float, float]]]:
    settings, measured = recipe.config.modal_test, recipe.config.measurement
    response = settings.response or measured.response or [3]
    reference = settings.reference or measured.reference or list(range(1, model.mesh.n_label + 1))
    for key, points, own in (("response", response, settings.response), ("reference", reference, settings.reference)):
        section = "modal_test" if own or not getattr(measured, key) else "measurement"
        recipe.told(f"{section}.{key}", lambda points=points: model.mesh.places(points))  # type: ignore[misc]
    return list(response), list(reference)


def _analyser(recipe: Run) -> Analyser:
    """A named analyser, or its settings with `like` as the start."""
    given = recipe.config.modal_test.analyser
    changes = {"like": given} if isinstance(given, str) else dict(given)
    name = str(changes.pop("like", "sr785"))
    if name not in ANALYSERS:
        raise recipe.error("modal_test.analyser", unknown_name("analyser", name, ANALYSERS))
    known = ANALYSERS[name].__dict__
    for key in changes:
        if key not in known:
            raise recipe.error("modal_test.analyser", unknown_name("setting of an analyser", key, known))
    settings = known | recipe.typed("modal_test.analyser", Analyser, changes)
    return recipe.told("modal_test.analyser", lambda: Analyser(**settings))


def _hammer(recipe: Run) -> Hammer:
    given = recipe.config.modal_test.hammer
    known = Hammer().__dict__
    for key in given:
        if key not in known:
            raise recipe.error("modal_test.hammer", unknown_name("setting of a hammer", key, known))
    settings = recipe.typed("modal_test.hammer", Hammer, given)
    return recipe.told("modal_test.hammer", lambda: Hammer(**settings))
