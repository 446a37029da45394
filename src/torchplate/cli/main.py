"""The command line. Exit status 0: done; 2: the user's input cannot be used; 1: a defect of ours."""

import argparse
import errno
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.padding import Padding
from rich.table import Table

from torchplate.cli.bench import PARTS, bench
from torchplate.cli.compare import compare
from torchplate.cli.config import InputError
from torchplate.cli.diagnose import diagnose
from torchplate.cli.inspect import inspect
from torchplate.cli.ranks import Ended, join
from torchplate.cli.run import follow, run
from torchplate.cli.simulate import simulate
from torchplate.effects import CATALOGUE, options
from torchplate.measurement import MeasurementError

# What the machine may refuse, and what the user can do about it.
OUTSIDE = {
    errno.EACCES: "Change its rights, or name another place",
    errno.EPERM: "Change its rights, or name another place",
    errno.EROFS: "Name a place that can be written to",
    errno.ENOSPC: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EDQUOT: "Make room on that disk, or name another place; a search goes on with --resume",
    errno.EIO: "Look after that disk, or name another place; a search goes on with --resume",
    errno.EISDIR: "Name a file",
    errno.ENOTDIR: "Correct the path",
    errno.ENAMETOOLONG: "Shorten the path",
    errno.ELOOP: "Correct the links on the path",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status."""
    parsed = _parser().parse_args(arguments)
    try:
        parsed.verb(parsed)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        if error.errno not in OUTSIDE or error.filename is None:
            raise
        what = f"{error.filename}: Expected a place that can be read and written, got '{error.strerror}'."
        print(f"{what} {OUTSIDE[error.errno]}.", file=sys.stderr)
        return 2
    except Ended as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(
            "Stopped. What was computed is in the run's folder; a population search goes on with --resume.",
            file=sys.stderr,
        )
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("torchplate", description="Model updating of plates from measured vibration.")
    parser.add_argument("--version", action="version", version=f"torchplate {version('torchplate-fem')}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    verb = verbs.add_parser("run", help="search the intervals of a config, or evaluate the model where it has none")
    verb.add_argument("config", type=Path, help="YAML file")
    verb.add_argument("--out", type=Path, help="the run's folder (default: runs/<config name>/<time>)")
    verb.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the config")
    verb.add_argument("--device", default="cpu", help="where the tensors live (default: cpu)")
    verb.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint in --out, or in the latest folder"
    )
    verb.add_argument("--force", action="store_true", help="write over what an earlier run has left in --out")
    verb.set_defaults(verb=_run)

    verb = verbs.add_parser("simulate", help="a virtual hammer test of a config's model, as an analyser would make it")
    verb.add_argument("config", type=Path, help="YAML file; numbers only")
    verb.add_argument("--out", type=Path, required=True, help="the file to write: .uff or .npz")
    verb.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the config")
    verb.set_defaults(verb=lambda a: simulate(a.config, a.out, a.set))

    verb = verbs.add_parser("diagnose", help="find where model and measurement disagree, and name what is missing")
    verb.add_argument("config", type=Path, help="YAML file")
    verb.add_argument("--out", type=Path, help="the folder (default: runs/<config name>/<time>)")
    verb.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the config")
    verb.add_argument("--device", default="cpu", help="where the tensors live (default: cpu)")
    verb.add_argument("--resume", action="store_true", help="leave it at what --out holds if that has ended")
    verb.add_argument("--force", action="store_true", help="write over what an earlier diagnosis has left in --out")
    verb.set_defaults(verb=_diagnose)

    verb = verbs.add_parser("compare", help="lay finished runs over each other")
    verb.add_argument("runs", type=Path, nargs="+", metavar="RUN_DIR", help="folders of finished runs")
    verb.add_argument("--out", type=Path, help="where the comparison goes (default: the folder above the runs)")
    verb.set_defaults(verb=lambda a: compare(a.runs, a.out))

    verb = verbs.add_parser("inspect", help="what a measurement file holds, and whether it can be trusted")
    verb.add_argument("file", type=Path, help=".uff, .unv or .npz")
    verb.add_argument("--out", type=Path, help="folder of the figure (default: runs/inspect)")
    verb.set_defaults(verb=lambda a: inspect(a.file, a.out))

    verb = verbs.add_parser("bench", help="how fast, beside SciPy one candidate at a time; about a quarter of an hour")
    verb.add_argument("--out", type=Path, help="folder of bench.json (default: runs/bench)")
    verb.add_argument(
        "--part", action="append", default=[], choices=list(PARTS), help="only this part (may be repeated)"
    )
    verb.set_defaults(verb=lambda a: bench(a.out, a.part))

    verb = verbs.add_parser("effects", help="the catalogue of effects")
    verb.set_defaults(verb=lambda _: effects(Console()))
    return parser


def _run(parsed: argparse.Namespace) -> None:
    """Alone, or as one of the processes that torchrun has started."""
    with join(parsed.device) as ranks:
        if ranks is None or ranks.rank == 0:
            run(parsed.config, parsed.out, parsed.set, parsed.device, parsed.resume, ranks=ranks, force=parsed.force)
        else:
            follow(ranks)


def _diagnose(parsed: argparse.Namespace) -> None:
    """Minutes at most, so one that was stopped begins anew; one that ended is not repeated."""
    if parsed.resume and parsed.out is not None and (parsed.out / "diagnosis.json").exists():
        print(f"{parsed.out} holds a diagnosis that has ended. Leave --resume out to repeat it.")
        return
    diagnose(parsed.config, parsed.out, parsed.set, parsed.device, force=parsed.force)


def effects(console: Console) -> None:
    """Print the catalogue: every effect, what it shows, its parameters and where a search looks for them."""
    for name, effect in CATALOGUE.items():
        console.print(f"[bold]{name}[/]  acts on {', '.join(sorted(effect.acts_on))}")
        console.print(Padding(effect.shows, (0, 0, 0, 2)))
        table = Table(box=None, show_header=False, padding=(0, 2))
        for wrapped in (False, False, False, True, True):
            table.add_column(no_wrap=not wrapped)
        for option in options(effect):
            table.add_row(option, "", "", "", "fixed, never searched")
        for key, parameter in effect.parameters.items():
            neutral = "" if parameter.neutral is None else f"neutral {parameter.neutral:g}"
            prior = "" if parameter.prior is None else parameter.prior.describe(parameter.unit)
            table.add_row(key, rf"\[{parameter.unit}]", neutral, prior, parameter.meaning)
        console.print(table)
    console.print("A, h, ρ, D: area, thickness, density and bending rigidity of the plate as it is in the model")
