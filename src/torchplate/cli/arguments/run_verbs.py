"""Verbs that take a config, or the runs of one."""

from typing import Final

from torchplate.cli.arguments.verb import ArgumentParser, Parsed, Verb, number, overwriting, place


def _config(parser: ArgumentParser, help: str = "YAML file") -> None:
    parser.add_argument("config", type=place, help=help)
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the config"
    )


def _device(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--device",
        default="cpu",
        help="where the search of a run is evaluated (default: cpu); all else is done on the CPU",
    )


def _folder(parser: ArgumentParser, what: str, resume: str) -> None:
    """A config that ends in a folder, which may hold an earlier one."""
    _config(parser)
    parser.add_argument("--out", type=place, help="the folder (default: runs/<config name>/<time>)")
    _device(parser)
    parser.add_argument("--resume", action="store_true", help=f"{resume}, in --out or in the latest folder")
    overwriting(parser, f"what an earlier {what} has left in --out")


def _run_arguments(parser: ArgumentParser) -> None:
    _folder(parser, "run", "go on from the checkpoint")


def _run(parsed: Parsed) -> None:
    """Alone, or as one of the processes that torchrun has started."""
    from torchplate.cli.machine.ranks import join
    from torchplate.cli.verbs.run import follow, run

    with join(parsed.device) as ranks:
        if ranks is None or ranks.rank == 0:
            run(
                parsed.config, parsed.out, parsed.set, parsed.device, parsed.resume, ranks=ranks, force=parsed.overwrite
            )
        else:
            follow(ranks)


def _diagnose_arguments(parser: ArgumentParser) -> None:
    _folder(parser, "diagnosis", "go on with one that was stopped")
    parser.add_argument(
        "--since", type=place, metavar="REFERENCE", help="the config of an earlier test of the plate: say what changed"
    )


def _diagnose(parsed: Parsed) -> None:
    """One that ended is not repeated."""
    from torchplate.cli.folder.opening import has_ended
    from torchplate.cli.verbs.diagnose import diagnose

    if parsed.resume and parsed.out is not None and has_ended(parsed.out):
        print(f"{parsed.out} holds a diagnosis that has ended. Leave --resume out to repeat it.")
        return
    diagnose(
        parsed.config,
        parsed.out,
        parsed.set,
        parsed.device,
        force=parsed.overwrite,
        resume=parsed.resume,
        since=parsed.since,
    )


def _plan_arguments(parser: ArgumentParser) -> None:
    from torchplate.planning import KINDS

    _config(parser)
    parser.add_argument("--from", type=place, dest="source", metavar="DIR", help="folder of its diagnosis")
    parser.add_argument("--out", type=place, help="the folder (default: that of the diagnosis)")
    parser.add_argument("--can", nargs="+", choices=list(KINDS), help="what the lab can do (default: all of it)")
    parser.add_argument(
        "--masses", type=number, nargs="+", default=[], metavar="KG", help="pieces that there are [kg]; else proposed"
    )
    overwriting(parser, "an earlier plan")
    _device(parser)


def _plan(parsed: Parsed) -> None:
    from torchplate.cli.config import InputError
    from torchplate.cli.verbs.plan import plan
    from torchplate.planning import KINDS, Lab

    try:
        lab = Lab(can=tuple(parsed.can or KINDS), masses=tuple(parsed.masses))
    except ValueError as error:
        raise InputError(f"--masses: {error}") from None
    plan(parsed.config, parsed.out, parsed.set, parsed.source, lab, force=parsed.overwrite, device=parsed.device)


def _compare_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs", type=place, nargs="+", metavar="RUN_DIR", help="folders of finished runs, or a folder above such"
    )
    parser.add_argument("--out", type=place, help="where the comparison goes (default: the folder above the runs)")
    overwriting(parser, "a comparison of other runs")


def _compare(parsed: Parsed) -> None:
    from torchplate.cli.verbs.compare import compare

    compare(parsed.runs, parsed.out, force=parsed.overwrite)


def _simulate_arguments(parser: ArgumentParser) -> None:
    _config(parser, "YAML file; numbers only")
    parser.add_argument("--out", type=place, required=True, help="the file to write: .uff or .npz")
    overwriting(parser, "another file of that name")


def _simulate(parsed: Parsed) -> None:
    from torchplate.cli.verbs.simulate import simulate

    simulate(parsed.config, parsed.out, parsed.set, force=parsed.overwrite)


RUN_VERBS: Final = {
    "run": Verb(
        "search the intervals of a config, or evaluate the model where it has none",
        (
            "torchplate run plate.yaml",
            "torchplate run plate.yaml --set search.seed=3 --set mesh.refine=2 --out runs/fine",
            "torchplate run plate.yaml --out runs/fine --resume    # goes on where it was stopped",
        ),
        _run_arguments,
        _run,
    ),
    "diagnose": Verb(
        "find where model and measurement disagree, and name what is missing",
        (
            "torchplate diagnose plate.yaml --out runs/plate",
            "torchplate diagnose plate.yaml --set measurement.position_std=0.002",
            "torchplate diagnose plate.yaml --out runs/plate --resume    # goes on where it was stopped",
            "torchplate diagnose after.yaml --since before.yaml --out runs/changed",
        ),
        _diagnose_arguments,
        _diagnose,
    ),
    "plan": Verb(
        "score the tests that a lab can do next by what they would tell of the name, and write the best one's config",
        (
            "torchplate plan plate.yaml",
            "torchplate plan plate.yaml --from runs/plate --can mass wires --masses 0.02 0.05",
        ),
        _plan_arguments,
        _plan,
    ),
    "compare": Verb(
        "lay finished runs over each other",
        (
            "torchplate compare runs/paper/differential_evolution runs/paper/artificial_bee_colony --out runs/compared",
            "torchplate compare runs --out runs/compared    # all that lie there, plate by plate",
        ),
        _compare_arguments,
        _compare,
    ),
    "simulate": Verb(
        "a virtual hammer test of a config's model, as an analyser would make it",
        ("torchplate simulate configs/virtual_plate.yaml --out plate.uff",),
        _simulate_arguments,
        _simulate,
    ),
}
