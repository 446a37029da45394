"""The diagnosis of a table: both meshes, every effect, the pairs, and what they are worth."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.result import Diagnosis
from torchplate.diagnosis.table.comparison import Comparing, Comparison, Weighed
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.found import Found
from torchplate.diagnosis.table.hypotheses import Fitted
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.posterior import Posterior
from torchplate.diagnosis.table.settings import SETTINGS, TableSettings
from torchplate.diagnosis.table.summary import summarise
from torchplate.diagnosis.tolerance import with_tolerances
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel


@torch.no_grad()
def diagnose_table(
    model: PlateModel,
    table: NaturalFrequencies,
    *,
    tolerance: Mapping[str, float] | None = None,
    say: Callable[[str], None] = lambda _: None,
    settings: TableSettings = SETTINGS,
) -> Diagnosis:
    """Find which effects a model lacks that natural frequencies were measured of.

    Args:
        model: the model as it is believed; its searched parameters are fitted.
        table: what was measured.
        tolerance: how well numbers are known: "label.parameter", "mesh.length_x" → standard deviation in SI units.
        say: is told what is being tried.
        settings: constants.
    """
    began = time.monotonic()
    known, prior = with_tolerances(model, dict(tolerance or {}))
    evidence = TableEvidence.of(table, settings)
    benches = [Comparing(Plates.corrected(known, evidence, settings), prior, settings, say)]
    if not model.mesh.extrapolate:
        benches.append(Comparing(Plates(known, evidence, "given", settings, 1), prior, settings, say))
    begun: list[tuple[Comparing, Weighed, Fitted]] = []
    for bench in benches:
        baseline, fitted = bench.baseline()
        say(f"{bench.plates.kind} mesh: the given model leaves {evidence.gap(baseline.best.predicted):.3g}")
        begun.append((bench, baseline, fitted))
    if len(begun) > 1 and _alike(begun[0], begun[1], settings):
        begun = begun[:1]
    compared: list[Comparison] = []
    for bench, baseline, fitted in begun:
        compared.append(bench.singles(baseline, fitted, compared[0] if compared else None))
    best = min(_best(one) for one in compared)
    for k, (bench, _, _) in enumerate(begun):
        # A mesh that is that much less probable would need a pair to come back.
        if _best(compared[k]) < best + settings.pairs_within:
            compared[k] = bench.with_pairs(compared[k], compared[0] if k else None)
    benches = [bench for bench, _, _ in begun]
    found = Found.of(_integrated(benches, compared, settings), prior, settings)
    return summarise(found, time.monotonic() - began)


def _integrated(
    benches: Sequence[Comparing], compared: Sequence[Comparison], settings: TableSettings
) -> list[Comparison]:
    """What may be the best is integrated over all its values, and the given model, which it is held against."""
    doubtful = {one.weighed for one in Posterior.of(compared, settings).entries if one.probability > settings.doubtful}

    def integrated(bench: Comparing, one: Weighed, every: Sequence[Weighed]) -> Weighed:
        same = [other for other in every if other.hypothesis is one.hypothesis and other is not one]
        return bench.integrated(one, same) if one in doubtful else one

    return [
        replace(
            one,
            baseline=bench.integrated(one.baseline),
            weighed=tuple(integrated(bench, other, one.weighed) for other in one.weighed),
        )
        for bench, one in zip(benches, compared, strict=True)
    ]


class FittedTable(NamedTuple):
    """A model fitted to a table, its mesh error taken off.

    Attributes:
        model: whose searched parameters these are, those of the tolerances among them.
        theta: of them, in SI units.
        position: the same on the unit cube.
        precision: inverse of the posterior covariance there.
        predicted: natural frequencies of the table's modes [Hz].
    """

    model: PlateModel
    theta: Float[Tensor, " n"]
    position: Float[Tensor, " n"]
    precision: Float[Tensor, "n n"]
    predicted: Float[Tensor, " n_mode"]


@torch.no_grad()
def fitted_table(
    model: PlateModel, table: NaturalFrequencies, tolerance: Mapping[str, float] | None = None
) -> FittedTable:
    """Fit a model to a table, and look for nothing beside it.

    Args:
        model: the model as it is believed.
        table: what was measured.
        tolerance: as for `diagnose_table`.
    """
    known, prior = with_tolerances(model, dict(tolerance or {}))
    plates = Plates.corrected(known, TableEvidence.of(table, SETTINGS), SETTINGS)
    found, _ = Comparing(plates, prior, SETTINGS, lambda _: None).baseline()
    return FittedTable(known, found.theta, found.best.position, found.best.precision, found.best.predicted)


def _best(one: Comparison) -> float:
    return min(weighed.evidence for weighed in (one.baseline, *one.weighed))


def _alike(
    one: tuple[Comparing, Weighed, Fitted], other: tuple[Comparing, Weighed, Fitted], settings: TableSettings
) -> bool:
    """Whether both meshes say the same of the given model, to a part of the standard deviations."""
    theta = one[1].theta
    found = [bench.plates.exactly(bench.plates.model, theta) for bench, _, _ in (one, other)]
    off = (found[0] - found[1]) / one[0].plates.evidence.scatter
    return float(off.abs().max()) < settings.alike
