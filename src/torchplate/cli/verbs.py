"""The verbs of the command line: what each takes, an example of each, and what it calls.

What a verb alone needs is imported when it is called, or asked for its help: `torchplate --help` waits for no torch.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ArgumentParser = argparse.ArgumentParser
Parsed = argparse.Namespace


@dataclass(frozen=True)
class Verb:
    """One word of the command line.

    Args:
        summary: what it does, half a line.
        examples: command lines that show it; a remark may follow a #.
        arguments: adds what it takes to its parser.
        call: does it.
    """

    summary: str
    examples: tuple[str, ...]
    arguments: Callable[[ArgumentParser], None]
    call: Callable[[Parsed], None]

    @property
    def epilog(self) -> str:
        """The examples as `--help` ends with them."""
        return "\n  ".join([f"example{'s' * (len(self.examples) > 1)}:", *self.examples])


def _config(parser: ArgumentParser, help: str = "YAML file") -> None:
    parser.add_argument("config", type=Path, help=help)
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the config"
    )


def _device(parser: ArgumentParser) -> None:
    parser.add_argument("--device", default="cpu", help="where the tensors live (default: cpu)")


def _run_arguments(parser: ArgumentParser) -> None:
    _config(parser)
    parser.add_argument("--out", type=Path, help="the run's folder (default: runs/<config name>/<time>)")
    _device(parser)
    parser.add_argument(
        "--resume", action="store_true", help="go on from the checkpoint in --out, or in the latest folder"
    )
    parser.add_argument("--force", action="store_true", help="write over what an earlier run has left in --out")


def _run(parsed: Parsed) -> None:
    """Alone, or as one of the processes that torchrun has started."""
    from torchplate.cli.ranks import join
    from torchplate.cli.run import follow, run

    with join(parsed.device) as ranks:
        if ranks is None or ranks.rank == 0:
            run(parsed.config, parsed.out, parsed.set, parsed.device, parsed.resume, ranks=ranks, force=parsed.force)
        else:
            follow(ranks)


def _diagnose_arguments(parser: ArgumentParser) -> None:
    _config(parser)
    parser.add_argument("--out", type=Path, help="the folder (default: runs/<config name>/<time>)")
    _device(parser)
    parser.add_argument(
        "--resume", action="store_true", help="go on with one that was stopped, in --out or in the latest folder"
    )
    parser.add_argument("--force", action="store_true", help="write over what an earlier diagnosis has left in --out")
    parser.add_argument(
        "--since", type=Path, metavar="REFERENCE", help="the config of an earlier test of the plate: say what changed"
    )


def _diagnose(parsed: Parsed) -> None:
    """One that ended is not repeated."""
    from torchplate.cli.diagnose import diagnose
    from torchplate.cli.folder import has_ended

    if parsed.resume and parsed.out is not None and has_ended(parsed.out):
        print(f"{parsed.out} holds a diagnosis that has ended. Leave --resume out to repeat it.")
        return
    diagnose(
        parsed.config,
        parsed.out,
        parsed.set,
        parsed.device,
        force=parsed.force,
        resume=parsed.resume,
        since=parsed.since,
    )


def _plan_arguments(parser: ArgumentParser) -> None:
    from torchplate.planning import KINDS

    _config(parser)
    parser.add_argument("--from", type=Path, dest="source", metavar="DIR", help="folder of its diagnosis")
    parser.add_argument("--out", type=Path, help="the folder (default: that of the diagnosis)")
    parser.add_argument("--can", nargs="+", choices=list(KINDS), help="what the lab can do (default: all of it)")
    parser.add_argument(
        "--masses", type=float, nargs="+", default=[], metavar="KG", help="pieces that there are [kg]; else proposed"
    )
    parser.add_argument("--force", action="store_true", help="write over an earlier plan")
    _device(parser)


def _plan(parsed: Parsed) -> None:
    from torchplate.cli.config import InputError
    from torchplate.cli.plan import plan
    from torchplate.planning import KINDS, Lab

    try:
        lab = Lab(can=tuple(parsed.can or KINDS), masses=tuple(parsed.masses))
    except ValueError as error:
        raise InputError(f"--masses: {error}") from None
    plan(parsed.config, parsed.out, parsed.set, parsed.source, lab, force=parsed.force, device=parsed.device)


def _new_arguments(parser: ArgumentParser) -> None:
    from torchplate.measurement import KINDS, METRES
    from torchplate.plate import MATERIALS

    parser.add_argument("file", type=Path, help=".uff, .unv or .npz with FRFs")
    parser.add_argument("--length", type=float, nargs=2, metavar=("LX", "LY"), help="sides [m]; else proposed")
    parser.add_argument("--thickness", type=float, metavar="H", help="[m]; else searched")
    parser.add_argument("--mass", type=float, metavar="M", help="of the whole plate [kg], for its density")
    parser.add_argument("--material", metavar="NAME", help=f"one of {', '.join(MATERIALS)}")
    parser.add_argument(
        "--nodes", type=Path, metavar="CSV", help="table node, x, y[, z], for files without coordinates"
    )
    parser.add_argument("--unit", choices=list(METRES), help="of the coordinates; else proposed")
    parser.add_argument(
        "--supports",
        nargs="+",
        default=[],
        metavar="WHERE",
        help="free (the default), springs (four, at guessed places), or places x,y of springs [m]",
    )
    parser.add_argument(
        "--edge", action="append", default=[], metavar="EDGE=HOW", help="x0=clamped, y1=simply_supported (may repeat)"
    )
    parser.add_argument("--kind", choices=list(KINDS), help="of the FRFs, where the file does not say")
    parser.add_argument("--out", type=Path, metavar="CONFIG.yaml", help="the config (default: the file's name .yaml)")


def _new(parsed: Parsed) -> None:
    from torchplate.cli.draft import Wishes
    from torchplate.cli.new import new

    wishes = Wishes(
        length=None if parsed.length is None else (parsed.length[0], parsed.length[1]),
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


def _simulate_arguments(parser: ArgumentParser) -> None:
    _config(parser, "YAML file; numbers only")
    parser.add_argument("--out", type=Path, required=True, help="the file to write: .uff or .npz")


def _simulate(parsed: Parsed) -> None:
    from torchplate.cli.simulate import simulate

    simulate(parsed.config, parsed.out, parsed.set)


def _compare_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "runs", type=Path, nargs="+", metavar="RUN_DIR", help="folders of finished runs, or a folder above such"
    )
    parser.add_argument("--out", type=Path, help="where the comparison goes (default: the folder above the runs)")


def _compare(parsed: Parsed) -> None:
    from torchplate.cli.compare import compare

    compare(parsed.runs, parsed.out)


def _inspect_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help=".uff, .unv, .npz, or time records: .wav, .mat, .csv, .lvm")
    parser.add_argument("--out", type=Path, help="folder of the figure (default: runs/inspect)")


def _inspect(parsed: Parsed) -> None:
    from torchplate.cli.inspect import inspect

    inspect(parsed.file, parsed.out)


def _frf_arguments(parser: ArgumentParser) -> None:
    from torchplate.measurement import ESTIMATES

    parser.add_argument("records", type=Path, nargs="+", metavar="RECORDS", help=".uff, .wav, .mat, .npz, .csv or .lvm")
    parser.add_argument("--out", type=Path, required=True, help="the file to write: .uff or .npz")
    parser.add_argument("--estimator", choices=list(ESTIMATES), default="H1", help="(default: H1)")
    parser.add_argument("--force", metavar="CHANNEL", help="name or number of the force channel (UFF: its node)")
    parser.add_argument("--reference", type=int, nargs="+", default=[], metavar="NODE", help="node hit, for each file")
    parser.add_argument("--response", type=int, nargs="+", default=[], metavar="NODE", help="node of each response")
    parser.add_argument(
        "--motion", choices=["acceleration", "velocity", "displacement"], help="what responses are, if the file is mute"
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="samples per second, if the file is mute")
    parser.add_argument(
        "--scale", type=float, nargs=2, default=(1.0, 1.0), metavar=("FORCE", "RESPONSE"), help="factors to N and SI"
    )
    parser.add_argument("--duration", type=float, metavar="S", help="length of a hit's record [s]")
    parser.add_argument("--pre-trigger", type=float, default=0.01, metavar="S", help="before it [s] (default: 0.01)")
    parser.add_argument("--trigger", type=float, default=0.1, help="part of the highest force (default: 0.1)")
    parser.add_argument("--force-window", type=float, metavar="S", help="the force counts as zero after it [s]")
    parser.add_argument("--exponential-window", type=float, metavar="S", help="time constant [s], on all channels")
    parser.add_argument("--keep-all", action="store_true", help="keep double hits and overloads")
    parser.add_argument("--nodes", type=Path, metavar="CSV", help="table node, x, y[, z] of their places [m]")


def _frf(parsed: Parsed) -> None:
    from torchplate.cli.config import InputError
    from torchplate.cli.frf import Conversion, frf
    from torchplate.measurement import Cutting, Layout, Windows

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


def _modes_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=Path, help=".uff, .unv or .npz with FRFs")
    parser.add_argument("--out", type=Path, metavar="MODES", help="the file to write: .csv, or .uff with datasets 55")
    parser.add_argument("--lowest", type=float, metavar="HZ", help="end of the band (default: the measurement's)")
    parser.add_argument("--highest", type=float, metavar="HZ", help="the other end")
    parser.add_argument(
        "--order", type=int, default=40, help="modes at most that the fitted polynomials can hold (default: 40)"
    )
    parser.add_argument("--nodes", type=Path, metavar="CSV", help="table node, x, y[, z] of the places [m]")


def _modes(parsed: Parsed) -> None:
    from torchplate.cli.modes import modes

    modes(parsed.file, parsed.out, parsed.lowest, parsed.highest, parsed.order, parsed.nodes)


def _bench_arguments(parser: ArgumentParser) -> None:
    from torchplate.cli.bench import PARTS

    parser.add_argument("--out", type=Path, help="folder of bench.json (default: runs/bench)")
    parser.add_argument(
        "--part", action="append", default=[], choices=list(PARTS), help="only this part (may be repeated)"
    )


def _bench(parsed: Parsed) -> None:
    from torchplate.cli.bench import bench

    bench(parsed.out, parsed.part)


def _effects_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("name", nargs="*", metavar="EFFECT", help="only these (default: all)")


def _effects(parsed: Parsed) -> None:
    from torchplate.cli.catalogue import effects

    effects(parsed.name)


def _keys_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("section", nargs="*", metavar="SECTION", help="mesh, measurement, search, ... (default: all)")


def _keys(parsed: Parsed) -> None:
    from torchplate.cli.reference import keys

    keys(parsed.section)


VERBS: Final = {
    "new": Verb(
        "write a commented config for a measurement",
        (
            "torchplate new plate.uff --length 0.48 0.48 --thickness 0.0027 --material steel",
            "torchplate run plate.yaml",
        ),
        _new_arguments,
        _new,
    ),
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
    "inspect": Verb(
        "what a file holds, what can be done with it, and whether its FRFs can be trusted",
        ("torchplate inspect plate.uff",),
        _inspect_arguments,
        _inspect,
    ),
    "frf": Verb(
        "FRFs and coherence from the time records of hits",
        (
            "torchplate frf hits.uff --out plate.uff",
            "# the node hit is the last number of a file's name; full scale is 50 N and 100 m/s2",
            "torchplate frf hit_1.wav hit_2.wav --response 7 --scale 50 100 --out plate.uff",
        ),
        _frf_arguments,
        _frf,
    ),
    "modes": Verb(
        "natural frequencies, damping and mode shapes from FRFs, by sdypy-EMA",
        (
            "torchplate modes plate.uff",
            "torchplate modes plate.uff --lowest 20 --highest 400 --out modes.csv",
        ),
        _modes_arguments,
        _modes,
    ),
    "keys": Verb(
        "every key of a config: unit, default, meaning, example",
        ("torchplate keys", "torchplate keys mesh"),
        _keys_arguments,
        _keys,
    ),
    "effects": Verb(
        "the catalogue of effects: parameters, units, what each changes",
        ("torchplate effects", "torchplate effects point_mass"),
        _effects_arguments,
        _effects,
    ),
    "bench": Verb(
        "how fast, beside SciPy one candidate at a time; about a quarter of an hour",
        ("torchplate bench --part generation",),
        _bench_arguments,
        _bench,
    ),
}
