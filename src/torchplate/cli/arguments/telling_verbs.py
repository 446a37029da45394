"""Verbs that take nothing, and tell what there is and how fast it is."""

from typing import Final

from torchplate.cli.arguments.verb import ArgumentParser, Parsed, Verb, overwriting, place


def _keys_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("section", nargs="*", metavar="SECTION", help="mesh, measurement, search, ... (default: all)")


def _keys(parsed: Parsed) -> None:
    from torchplate.cli.verbs.keys import keys

    keys(parsed.section)


def _effects_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("name", nargs="*", metavar="EFFECT", help="only these (default: all)")


def _effects(parsed: Parsed) -> None:
    from torchplate.cli.verbs.effects import effects

    effects(parsed.name)


def _bench_arguments(parser: ArgumentParser) -> None:
    from torchplate.cli.verbs.bench import PARTS

    parser.add_argument("--out", type=place, help="folder of bench.json (default: runs/bench)")
    overwriting(parser, "the same parts in --out; those in runs/bench are always timed anew")
    parser.add_argument(
        "--part", action="append", default=[], choices=list(PARTS), help="only this part (may be repeated)"
    )


def _bench(parsed: Parsed) -> None:
    from torchplate.cli.verbs.bench import bench

    bench(parsed.out, parsed.part, force=parsed.overwrite)


TELLING_VERBS: Final = {
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
