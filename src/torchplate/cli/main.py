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
from torchplate.cli.frf import Conversion, frf
from torchplate.cli.inspect import inspect
from torchplate.cli.new import Wishes, new
from torchplate.cli.ranks import Ended, join
from torchplate.cli.run import follow, run
from torchplate.cli.simulate import simulate
from torchplate.effects import CATALOGUE, options
from torchplate.measurement import ESTIMATES, KINDS, METRES, Cutting, Layout, MeasurementError, Windows
from torchplate.plate import MATERIALS

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

    verb = verbs.add_parser(
        "new",
        help="write a commented config for a measurement",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example:\n  torchplate new plate.uff --length 0.48 0.48 --thickness 0.0027 --material steel\n"
        "  torchplate run plate.yaml",
    )
    verb.add_argument("file", type=Path, help=".uff, .unv or .npz with FRFs")
    verb.add_argument("--length", type=float, nargs=2, metavar=("LX", "LY"), help="sides [m]; else proposed")
    verb.add_argument("--thickness", type=float, metavar="H", help="[m]; else searched")
    verb.add_argument("--mass", type=float, metavar="M", help="of the whole plate [kg], for its density")
    verb.add_argument("--material", metavar="NAME", help=f"one of {', '.join(MATERIALS)}")
    verb.add_argument("--nodes", type=Path, metavar="CSV", help="table node, x, y[, z], for files without coordinates")
    verb.add_argument("--unit", choices=list(METRES), help="of the coordinates; else proposed")
    verb.add_argument(
        "--supports",
        nargs="+",
        default=[],
        metavar="WHERE",
        help="free (the default), springs (four, at guessed places), or places x,y of springs [m]",
    )
    verb.add_argument(
        "--edge", action="append", default=[], metavar="EDGE=HOW", help="x0=clamped, y1=simply_supported (may repeat)"
    )
    verb.add_argument("--kind", choices=list(KINDS), help="of the FRFs, where the file does not say")
    verb.add_argument("--out", type=Path, metavar="CONFIG.yaml", help="the config (default: the file's name .yaml)")
    verb.set_defaults(verb=_new)

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

    verb = verbs.add_parser(
        "inspect",
        help="what a file holds, what can be done with it, and whether its FRFs can be trusted",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example:\n  torchplate inspect plate.uff",
    )
    verb.add_argument("file", type=Path, help=".uff, .unv, .npz, or time records: .wav, .mat, .csv, .lvm")
    verb.add_argument("--out", type=Path, help="folder of the figure (default: runs/inspect)")
    verb.set_defaults(verb=lambda a: inspect(a.file, a.out))

    verb = verbs.add_parser(
        "frf",
        help="FRFs and coherence from the time records of hits",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="examples:\n  torchplate frf hits.uff --out plate.uff\n"
        "  torchplate frf hit_1.wav hit_2.wav --response 7 --scale 50 100 --out plate.uff    # the node hit is the last"
        "\n                                                    # number of the name; full scale is 50 N and 100 m/s2",
    )
    verb.add_argument("records", type=Path, nargs="+", metavar="RECORDS", help=".uff, .wav, .mat, .npz, .csv or .lvm")
    verb.add_argument("--out", type=Path, required=True, help="the file to write: .uff or .npz")
    verb.add_argument("--estimator", choices=list(ESTIMATES), default="H1", help="(default: H1)")
    verb.add_argument("--force", metavar="CHANNEL", help="name or number of the force channel (UFF: its node)")
    verb.add_argument("--reference", type=int, nargs="+", default=[], metavar="NODE", help="node hit, for each file")
    verb.add_argument("--response", type=int, nargs="+", default=[], metavar="NODE", help="node of each response")
    verb.add_argument(
        "--motion", choices=["acceleration", "velocity", "displacement"], help="what responses are, if the file is mute"
    )
    verb.add_argument("--rate", type=float, metavar="HZ", help="samples per second, if the file is mute")
    verb.add_argument(
        "--scale", type=float, nargs=2, default=(1.0, 1.0), metavar=("FORCE", "RESPONSE"), help="factors to N and SI"
    )
    verb.add_argument("--duration", type=float, metavar="S", help="length of a hit's record [s]")
    verb.add_argument("--pre-trigger", type=float, default=0.01, metavar="S", help="before it [s] (default: 0.01)")
    verb.add_argument("--trigger", type=float, default=0.1, help="part of the highest force (default: 0.1)")
    verb.add_argument("--force-window", type=float, metavar="S", help="the force counts as zero after it [s]")
    verb.add_argument("--exponential-window", type=float, metavar="S", help="time constant [s], on all channels")
    verb.add_argument("--keep-all", action="store_true", help="keep double hits and overloads")
    verb.add_argument("--nodes", type=Path, metavar="CSV", help="table node, x, y[, z] of their places [m]")
    verb.set_defaults(verb=_frf)

    verb = verbs.add_parser("bench", help="how fast, beside SciPy one candidate at a time; about a quarter of an hour")
    verb.add_argument("--out", type=Path, help="folder of bench.json (default: runs/bench)")
    verb.add_argument(
        "--part", action="append", default=[], choices=list(PARTS), help="only this part (may be repeated)"
    )
    verb.set_defaults(verb=lambda a: bench(a.out, a.part))

    verb = verbs.add_parser("effects", help="the catalogue of effects")
    verb.set_defaults(verb=lambda _: effects(Console()))
    return parser


def _new(parsed: argparse.Namespace) -> None:
    sides = None if parsed.length is None else (parsed.length[0], parsed.length[1])
    wishes = Wishes(
        length=sides,
        thickness=parsed.thickness,
        mass=parsed.mass,
        material=parsed.material,
        nodes=parsed.nodes,
        unit=parsed.unit,
        supports=tuple(parsed.supports),
        edges=tuple(parsed.edge),
        kind=parsed.kind,
    )
    new(parsed.file, wishes, parsed.out)


def _frf(parsed: argparse.Namespace) -> None:
    try:
        kept = {"double_hit": None, "overload": None} if parsed.keep_all else {}
        told = Conversion(
            layout=Layout(
                force=parsed.force,
                rate=parsed.rate,
                responses=tuple(parsed.response),
                scale=(parsed.scale[0], parsed.scale[1]),
                motion=parsed.motion,
            ),
            references=tuple(parsed.reference),
            cutting=Cutting(parsed.trigger, parsed.pre_trigger, parsed.duration, **kept),
            windows=Windows(parsed.force_window, parsed.exponential_window),
            estimator=parsed.estimator,
            nodes=parsed.nodes,
        )
    except ValueError as error:
        raise InputError(str(error)) from None
    frf(parsed.records, parsed.out, told)


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
