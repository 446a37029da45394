"""Verbs that take what was measured."""

from typing import Final

from torchplate.cli.arguments.verb import ArgumentParser, Parsed, Verb, number, overwriting, place


def _new_arguments(parser: ArgumentParser) -> None:
    from torchplate.measurement import KINDS, METRES
    from torchplate.plate import MATERIALS

    parser.add_argument("file", type=place, help=".uff, .unv or .npz with FRFs")
    parser.add_argument("--length", type=number, nargs=2, metavar=("LX", "LY"), help="sides [m]; else proposed")
    parser.add_argument("--thickness", type=number, metavar="H", help="[m]; else searched")
    parser.add_argument("--mass", type=number, metavar="M", help="of the whole plate [kg], for its density")
    parser.add_argument("--material", metavar="NAME", help=f"one of {', '.join(MATERIALS)}")
    parser.add_argument(
        "--nodes", type=place, metavar="CSV", help="table node, x, y[, z], for files without coordinates"
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
    parser.add_argument("--out", type=place, metavar="CONFIG.yaml", help="the config (default: the file's name .yaml)")
    overwriting(parser, "a config that is there and another")


def _new(parsed: Parsed) -> None:
    from torchplate.cli.verbs.new import new
    from torchplate.cli.verbs.new_draft import Wishes

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
    new(parsed.file, wishes, parsed.out, force=parsed.overwrite)


def _inspect_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=place, help=".uff, .unv, .npz, or time records: .wav, .mat, .csv, .lvm")
    parser.add_argument("--out", type=place, help="folder of the figure (default: runs/inspect)")
    overwriting(parser, "another figure in --out; that in runs/inspect is always made anew")


def _inspect(parsed: Parsed) -> None:
    from torchplate.cli.verbs.inspect import inspect

    inspect(parsed.file, parsed.out, force=parsed.overwrite)


def _frf_arguments(parser: ArgumentParser) -> None:
    from torchplate.measurement import ESTIMATES

    parser.add_argument(
        "records", type=place, nargs="+", metavar="RECORDS", help=".uff, .wav, .mat, .npz, .csv or .lvm"
    )
    parser.add_argument("--out", type=place, required=True, help="the file to write: .uff or .npz")
    overwriting(parser, "another file of that name", force_is_a_channel=True)
    parser.add_argument("--estimator", choices=list(ESTIMATES), default="H1", help="(default: H1)")
    parser.add_argument(
        "--force",
        metavar="CHANNEL",
        help="name or number of the force channel (UFF: its node); else the one so named, or of the shortest pulses",
    )
    parser.add_argument(
        "--reference", type=int, nargs="+", default=[], metavar="NODE", help="node hit, for each file or column"
    )
    parser.add_argument("--response", type=int, nargs="+", default=[], metavar="NODE", help="node of each response")
    parser.add_argument(
        "--motion", choices=["acceleration", "velocity", "displacement"], help="what responses are, if the file is mute"
    )
    parser.add_argument("--rate", type=number, metavar="HZ", help="samples per second, if the file is mute")
    parser.add_argument(
        "--scale", type=number, nargs=2, default=(1.0, 1.0), metavar=("FORCE", "RESPONSE"), help="factors to N and SI"
    )
    parser.add_argument("--duration", type=number, metavar="S", help="length of a hit's record [s]")
    parser.add_argument("--pre-trigger", type=number, default=0.01, metavar="S", help="before it [s] (default: 0.01)")
    parser.add_argument("--trigger", type=number, default=0.1, help="part of the highest force (default: 0.1)")
    parser.add_argument("--force-window", type=number, metavar="S", help="the force counts as zero after it [s]")
    parser.add_argument("--exponential-window", type=number, metavar="S", help="time constant [s], on all channels")
    parser.add_argument("--keep-all", action="store_true", help="keep double hits and overloads")
    parser.add_argument(
        "--nodes", type=place, metavar="CSV", help="table node, x, y[, z] of their places [m, or as its head says]"
    )


def _frf(parsed: Parsed) -> None:
    from torchplate.cli.config import InputError
    from torchplate.cli.verbs.frf import Conversion, frf
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
            overwrite=parsed.overwrite,
        )
    except ValueError as error:
        raise InputError(str(error)) from None
    frf(parsed.records, parsed.out, told)


def _modes_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", type=place, help=".uff, .unv or .npz with FRFs")
    parser.add_argument("--out", type=place, metavar="MODES", help="the file to write: .csv, or .uff with datasets 55")
    overwriting(parser, "another file of that name")
    parser.add_argument("--lowest", type=number, metavar="HZ", help="end of the band (default: the measurement's)")
    parser.add_argument("--highest", type=number, metavar="HZ", help="the other end")
    parser.add_argument(
        "--order", type=int, default=40, help="modes at most that the fitted polynomials can hold (default: 40)"
    )
    parser.add_argument(
        "--nodes", type=place, metavar="CSV", help="table node, x, y[, z] of the places [m, or as its head says]"
    )


def _modes(parsed: Parsed) -> None:
    from torchplate.cli.verbs.modes import modes

    band = parsed.lowest, parsed.highest
    modes(parsed.file, parsed.out, *band, parsed.order, parsed.nodes, force=parsed.overwrite)


FILE_VERBS: Final = {
    "new": Verb(
        "write a commented config for a measurement",
        (
            "torchplate new plate.uff --length 0.48 0.48 --thickness 0.0027 --material steel",
            "torchplate run plate.yaml",
        ),
        _new_arguments,
        _new,
    ),
    "inspect": Verb(
        "what a file holds, what can be done with it, and whether its FRFs can be trusted",
        ("torchplate inspect plate.uff",),
        _inspect_arguments,
        _inspect,
    ),
    "frf": Verb(
        "FRFs and coherence from the time records of hits, or from tables of FRFs",
        (
            "torchplate frf hits.uff --out plate.uff",
            "# the node hit is the last number of a file's name; full scale is 50 N and 100 m/s2",
            "torchplate frf hit_1.wav hit_2.wav --response 7 --scale 50 100 --out plate.uff",
            "# FRFs of MATLAB or a spreadsheet, in columns: where the sensor was, where was hit",
            "torchplate frf frfs.mat --response 3 --reference 28 102 104 --motion acceleration --out plate.uff",
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
}
