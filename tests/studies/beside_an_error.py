"""What the best effect takes beside an inflated error of the model: where it is there, and where it stands in.

`python -m tests.studies.beside_an_error`: the measured plates of spruce, whose grain is there; blind plates of one FRF
with something beyond the catalogue, whose best effect is not there; and some of these with a grain, too.

Each column is what a rule could go by that says which of these is named: the odds against none, and what is left, over
what is left without the effect, of the gap, of the squares over the inflated error, of those where peaks overlap, and
of bands that no fit saw, as wide as a half, a third and a fifth of the whole.

`--set WORD` takes blind plates of a set that nobody has looked at, with a grain and without, and counts the grains that
some rules would name, and what else they would.
"""

import argparse
import dataclasses
import math
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind import beyond, cases
from blind.effects import Hidden, apply, bare
from blind.suite import chosen
from torchplate.cli.config.build import load_run
from torchplate.cli.config.plate_test import plate_test
from torchplate.diagnosis import PlateTest
from torchplate.diagnosis.fit import fit
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.selection.criterion import choose, evidence, weight_of
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.selection.trace import State
from torchplate.diagnosis.selection.worth import where_peaks_overlap
from torchplate.diagnosis.target import FrfTarget
from torchplate.measurement import Imperfections, noise_level

GRAIN = Hidden("orthotropy", {}, {"young_ratio": 0.6, "shear_factor": 1.15})
SPRUCE = ("spruce_1L", "spruce_3R")
# Cases of sets that were seen before.
BEYOND = (("J", 33), ("J", 59), ("A", 2), ("A", 73), ("A", 83), ("A", 101))
WITH_GRAIN = (("J", 33), ("A", 83), ("A", 101))
N_BAND = (2, 3, 5)
# Of a set that nobody has looked at, the first so many with something beyond the catalogue.
N_FRESH = 16
# What leaves so much of the gap, or of the squares where peaks overlap, is named.
RULES = {
    "a quarter of the gap": (0.75, 0.0),
    "half of the gap": (0.5, 0.0),
    "half of the gap where peaks overlap": (0.0, 0.25),
    "half of either": (0.5, 0.25),
}


def of_one_frf(seed_set: str, index: int, hidden: Hidden | None, folder: Path) -> tuple[str, PlateTest]:
    """What is beyond the catalogue in a blind case, and its test with the first FRF alone.

    Args:
        seed_set: of the case.
        index: of the case.
        hidden: beside that; None for nothing.
        folder: where config and measurement are written.
    """
    case = cases.draw(seed_set, index)
    assert case.measurement is not None
    rng = np.random.default_rng([*cases.seed_of(seed_set, index), 3])
    if hidden is not None:
        frf, _ = beyond.draw(rng, case.truth[0].effect, apply(bare(case.specimen), case.specimen, hidden))
        measurement = cases.measure(rng, case.specimen, frf, case.noise, None, True)
    else:
        measurement = dataclasses.replace(case.measurement, coherence=None)
    alone = torch.zeros_like(measurement.measured)
    alone[0, 0] = True
    measurement = dataclasses.replace(measurement, measured=alone, frf=measurement.frf * alone)
    case.config["measurement"].pop("n_average", None)
    written = dataclasses.replace(case, measurement=measurement).write(folder / f"{seed_set}{index}{hidden is None}")
    return case.truth[0].effect, plate_test(load_run(written))


def beside_an_inflated_error(test: PlateTest) -> tuple[ForwardSelection, State]:
    """The given model, weighed by what it leaves."""
    assert test.measurement is not None
    measurement, noise = test.measurement, noise_level(test.measurement, test.n_average)
    none = torch.zeros_like(measurement.measured)
    target = FrfTarget(measurement, noise, none, test.gain_is_unknown, test.imperfections or Imperfections())
    selection = ForwardSelection.of(test.model, target, test.tolerance, lambda _: None)
    return selection.inflated(selection.baseline())


def left_out(selection: ForwardSelection, found: Fit, n_band: int) -> float:
    """Sum of squares over bands, each as the model has it that was fitted to the others."""
    target, square = selection.builder.target, 0.0
    assert target.model_variance is not None
    for band in torch.arange(len(target.frequency)).chunk(n_band):
        variance = target.model_variance.clone()
        # Ten decades above all others they weigh nothing.
        variance[band] = 1e10 * variance.max()
        twin = selection.builder.against(dataclasses.replace(target, model_variance=variance))
        start = found.model.space.to_cube(found.theta)[None]
        ended = fit(twin, found.model, start, selection.prior, wide=False)
        off = (target.measured - ended.prediction).abs().square() / target.variance
        square += float(off[..., target.fitted][band].sum())
    return square


class Best(NamedTuple):
    """The best effect beside an inflated error.

    Attributes:
        selection: what found it.
        before: the fit without it.
        name: its own; "nothing" where none is worth a refit.
        after: the fit with it.
        odds: ln of those against none.
        gap: what is left of it, over what is left without.
        overlapping: likewise of the squares where peaks overlap.
    """

    selection: ForwardSelection
    before: Fit
    name: str
    after: Fit
    odds: float
    gap: float
    overlapping: float

    def is_named(self, gap: float, overlapping: float) -> bool:
        """Whether a rule names it, that asks for one of these."""
        return self.odds > 0 and (self.gap <= gap or self.overlapping <= overlapping)


@torch.no_grad()
def best_of(test: PlateTest) -> Best:
    """The best effect of a test of one FRF."""
    selection, state = beside_an_inflated_error(test)
    ranked, before = selection.ranking.at(state), state.fit
    if not ranked.hypotheses:
        return Best(selection, before, "nothing", before, 0.0, 1.0, 1.0)
    best = choose(ranked.hypotheses, before).best
    after, weight = best.fit, weight_of([before, best.fit])
    none = evidence(before, weight) - 2 * math.log(1 - before.comparison.missing)
    odds, left = 0.5 * (none - best.against(weight)), after.left / before.left
    overlapping = where_peaks_overlap(selection.builder, after) / where_peaks_overlap(selection.builder, before)
    return Best(selection, before, best.name, after, odds, left, overlapping)


@torch.no_grad()
def row(test: PlateTest) -> list[str]:
    """The best effect, and what it takes, in the order of the columns."""
    best = best_of(test)
    if best.name == "nothing":
        return ["nothing"]
    parts = [best.gap, best.after.square / best.before.square, best.overlapping]
    parts += [left_out(best.selection, best.after, n) / left_out(best.selection, best.before, n) for n in N_BAND]
    return [best.name, f"{best.odds:.1f}", *(f"{part:.2f}" for part in parts)]


def fresh(console: Console, seed_set: str) -> None:
    """Print the best effects of plates that nobody has looked at, and what rules would name."""
    every: list[tuple[bool, Best]] = []
    table = Table("case", "beyond the catalogue", "grain", "best effect", "ln odds", "gap", "overlapping")
    with tempfile.TemporaryDirectory() as folder:
        for index in chosen("0:", "beyond")[:N_FRESH]:
            for hidden in (GRAIN, None):
                what, test = of_one_frf(seed_set, index, hidden, Path(folder))
                best = best_of(test)
                every.append((hidden is not None, best))
                told = (f"{best.odds:.1f}", f"{best.gap:.3f}", f"{best.overlapping:.3f}")
                table.add_row(f"{seed_set} {index}", what, "yes" if hidden else "no", best.name, *told)
    console.print(table)
    counts = Table("named is what takes", "grains named", "of", "false names", "of")
    for rule, parts in RULES.items():
        named = [(grain, best.name) for grain, best in every if best.is_named(*parts)]
        right = sum(grain and name == "orthotropy" for grain, name in named)
        n_grain = sum(grain for grain, _ in every)
        counts.add_row(rule, str(right), str(n_grain), str(len(named) - right), str(len(every)))
    console.print(counts)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.beside_an_error", description=__doc__)
    parser.add_argument("--set", dest="seed_set", help="of blind plates; left out, those of the table in the docs")
    given = parser.parse_args()
    console = Console(width=150)
    if given.seed_set:
        fresh(console, given.seed_set)
        return
    table = Table("plate", "best effect", "ln odds", "gap", "squares", "overlapping", "halves", "thirds", "fifths")
    for name in SPRUCE:
        table.add_row(name, *row(plate_test(load_run(f"configs/real/{name}.yaml"))))
    with tempfile.TemporaryDirectory() as folder:
        for seed_set, index in WITH_GRAIN:
            what, test = of_one_frf(seed_set, index, GRAIN, Path(folder))
            table.add_row(f"{seed_set} {index}: grain, {what}", *row(test))
        for seed_set, index in BEYOND:
            what, test = of_one_frf(seed_set, index, None, Path(folder))
            table.add_row(f"{seed_set} {index}: {what}", *row(test))
    console.print(table)


if __name__ == "__main__":
    main()
