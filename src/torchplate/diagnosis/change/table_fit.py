"""A change fitted to two tables of natural frequencies.

What a model leaves of each mode is in both tests, and cancels in the ratio of a mode's frequencies. With u what is
common, p what has changed and p₀ what leaves the model as it was,

    ln (f_after / f_before) = ln f(u, p) − ln f(u, p₀) + e,    e ~ κ N(0, S),
    S = diag(σ_after² + σ_before² + drift_mode²) + drift_all² 1 1ᵀ + G C Gᵀ,

C the covariance of u as the reference leaves it, where each mode may be off by `mode_stiffness`, and G what a change of
u makes of the right side. What p does to a mode is besides as uncertain as the model's shapes (`ChangeSettings.shape`).
κ² ~ inverse gamma(ν/2, ν/2) integrates out as in `diagnosis.table.evidence`. What went away was there before: both
sides change places. Several minima of a hypothesis, each by Laplace's approximation, add up; those that may be the best
are integrated over their boxes (`integral`).
"""

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.integral import Peak, integrate
from torchplate.diagnosis.model_builder import with_candidate
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.table.evidence import of_unknown_scale
from torchplate.diagnosis.table.settings import SETTINGS as TABLE
from torchplate.model import PlateModel
from torchplate.search import JACOBIANS, least_squares


@dataclass(frozen=True, eq=False)
class Tables:
    """Two tables, and the model of the reference.

    Attributes:
        model: of the reference; its parameters are what is common.
        after: of the test after, with other numbers and effects where its config has them.
        before: values of all of these, in SI units.
        covariance: of the searched ones, on the unit cube.
        mode: modes that both tables hold, from 0.
        ratio: ln of each one's frequency after over that before.
        variance: S without what u makes of it.
        freedom: ν.
        missed: how far the model misses the modes of the reference: root mean square of ln f [-].
    """

    model: PlateModel
    after: PlateModel
    before: Mapping[str, float]
    covariance: Float[Tensor, "n n"]
    mode: Tensor
    ratio: Float[Tensor, " n_mode"]
    variance: Float[Tensor, "n_mode n_mode"]
    freedom: float
    missed: float

    def gap(self, predicted: Float[Tensor, " n_mode"]) -> float:
        """Root mean square of the relative error of the frequencies after [-]."""
        return float((predicted - self.ratio).exp().sub(1).square().mean().sqrt())

    @property
    def floor(self) -> float:
        """What scatter and drift alone make the gap [-]."""
        return float(self.variance.diagonal().mean().sqrt())


@dataclass(frozen=True, eq=False)
class TableFit:
    """One hypothesis, fitted.

    Attributes:
        change: it; None for none.
        gone: it was there before, and is no more.
        model: with it, what has changed searched and all else numbers.
        place: of what has changed, on the unit cube.
        covariance: of that.
        predicted: ln of the ratio of frequencies.
        slope: of that, over what has changed.
        chi_square: of what is left.
        evidence: −2 ln Z: by Laplace's method, all minima together, or over the whole box.
        cost: −2 ln L.
        posed: what was fitted; None where nothing was.
        peaks: the minima.
    """

    change: Change | None
    gone: bool
    model: PlateModel
    place: Float[Tensor, " n"]
    covariance: Float[Tensor, "n n"]
    predicted: Float[Tensor, " n_mode"]
    slope: Float[Tensor, "n_mode n"]
    chi_square: float
    evidence: float
    cost: float
    posed: "Posed | None" = None
    peaks: tuple[Peak, ...] = ()


@dataclass(frozen=True, eq=False)
class Posed:
    """One hypothesis, ready to be evaluated.

    Attributes:
        tables: what it is held against.
        model: with it, what has changed searched and all else numbers.
        sign: −1 where it was there before.
        base: logarithms of the frequencies of the test in which it is not.
        none: ln of the ratio of frequencies where nothing has changed.
        shape: relative error of what it does to a mode [-].
    """

    tables: Tables
    model: PlateModel
    sign: float
    base: Float[Tensor, " n_mode"]
    none: Float[Tensor, " n_mode"]
    shape: float

    def predicted(self, places: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_mode"]:
        """Ln of the ratio of frequencies."""
        found = log_frequency(self.model, self.model.space.to_si(places), self.tables.mode)
        return self.sign * (found - self.base)

    def lower(
        self, predicted: Float[Tensor, "*batch n_mode"], common: Float[Tensor, "n_mode n_mode"]
    ) -> Float[Tensor, "*batch n_mode n_mode"]:
        """The Cholesky factor of S, what is common and the modes' shapes in it."""
        shapes = torch.diag_embed((self.shape * (predicted - self.none)).square())
        return torch.linalg.cholesky(self.tables.variance + common + shapes)

    def over(
        self, lower: Float[Tensor, "*factor n_mode n_mode"], predicted: Float[Tensor, "*batch n_mode"]
    ) -> Float[Tensor, "*batch n_mode"]:
        """What is left, over that factor."""
        left = (predicted - self.tables.ratio).unsqueeze(-1)
        return torch.linalg.solve_triangular(lower, left, upper=False).squeeze(-1)

    def cost(
        self, places: Float[Tensor, "n_draw n"], common: Float[Tensor, "n_mode n_mode"]
    ) -> Float[Tensor, " n_draw"]:
        """−2 ln L of members, each beside what its own change leaves open."""
        predicted = self.predicted(places)
        lower = self.lower(predicted, common)
        chi_square = self.over(lower, predicted).square().sum(dim=-1)
        logdet = 2 * lower.diagonal(dim1=-2, dim2=-1).log().sum(dim=-1)
        return of_unknown_scale(chi_square, self.tables.freedom, len(self.tables.mode)) + logdet


def log_frequency(model: PlateModel, theta: Float[Tensor, "*batch n"], mode: Tensor) -> Float[Tensor, "*batch n_mode"]:
    """Logarithms of some of a model's natural frequencies."""
    found = model.natural_frequencies(theta, int(mode.max()) + 1, check=False)[..., mode]
    return found.clamp(min=1e-9).log()


def frozen(tables: Tables, change: Change | None, gone: bool = False) -> PlateModel:
    """A model with what has changed searched and all else as numbers: of the test after, or before where it went."""
    model = tables.model if gone else tables.after
    if change is not None and change.candidate is not None:
        model = with_candidate(model, change.label, change.candidate)
    values = {key: value for key, value in tables.before.items() if key in model.names}
    middle = {key: 0.5 * (one.low + one.high) for key, one in model.searched.items()}
    own = [] if change is None else change.frees(model.names)
    fixed = {key: values.get(key, middle[key]) for key in model.names if key not in own}
    searched = {key: one for key, one in model.searched.items() if key in own}
    known = {**model.known_values, **fixed}
    if change is not None and change.candidate is None:
        assert change.interval is not None
        known.pop(change.name, None)
        searched = {change.name: change.interval}
    return model.replaced(known=known, searched=searched)


def numbers(tables: Tables, after: bool) -> Float[Tensor, " n_mode"]:
    """Logarithms of the frequencies of a model as the reference has left its parameters."""
    model = frozen(tables, None, not after)
    return log_frequency(model, model.known.new_zeros(0), tables.mode)


def _log_evidence(tables: Tables, chi_square: float, logdet: float) -> float:
    """−2 ln p of the ratios, κ integrated out."""
    whole = torch.tensor(chi_square, dtype=torch.float64)
    return float(of_unknown_scale(whole, tables.freedom, len(tables.mode))) + logdet


def none_of(tables: Tables) -> TableFit:
    """Nothing changed but what both configs say."""
    model = frozen(tables, None)
    zero = numbers(tables, True) - numbers(tables, False)
    left, nothing = tables.ratio - zero, tables.ratio.new_zeros(0)
    variance = tables.variance + _by_common(tables, None, False, model, nothing)
    chi_square = float(left @ torch.linalg.solve(variance, left))
    cost = _log_evidence(tables, chi_square, float(torch.linalg.slogdet(variance).logabsdet))
    return TableFit(
        None, False, model, nothing, left.new_zeros(0, 0), zero, left.new_zeros(len(left), 0), chi_square, cost, cost
    )


def fitted(tables: Tables, change: Change, gone: bool, settings: ChangeSettings) -> TableFit | None:
    """The minima of one hypothesis; None where it says nothing."""
    model = frozen(tables, change, gone)
    n = len(model.names)
    if not n:
        return None
    none = numbers(tables, True) - numbers(tables, False)
    shape = settings.shape * tables.missed
    posed = Posed(tables, model, -1.0 if gone else 1.0, numbers(tables, after=gone), none, shape)

    def over(lower: Tensor, places: Tensor) -> Tensor:
        return posed.over(lower, posed.predicted(places))

    library = SobolEngine(n).draw(1 + settings.n_library * min(n, 3), dtype=torch.float64)[1:].to(model.known)
    whole = torch.linalg.cholesky(tables.variance)
    square = over(whole, library).square().sum(-1).nan_to_num(math.inf)
    places = library[square.argsort()[: settings.n_start]]
    for n_iteration in (12, 6):
        # What u makes of it hangs on what has changed.
        lower = posed.lower(posed.predicted(places[0]), _by_common(tables, change, gone, model, places[0]))
        ended = least_squares(
            functools.partial(over, lower), places, jacobian="forward", n_iteration=n_iteration, step_tolerance=1e-6
        )
        places = ended.position[ended.objective.argsort()]
    logdet = 2 * float(lower.diagonal().log().sum())
    left = over(lower, places)
    slopes = JACOBIANS["forward"].differentiate(functools.partial(over, lower), places, left)
    minima = []
    for place, rest, slope in zip(places, left, slopes, strict=True):
        chi_square = float(rest.square().sum())
        kappa = (tables.freedom + chi_square) / (tables.freedom + len(tables.mode))
        precision = slope.mT @ slope / kappa + UNIFORM * torch.eye(n).to(slope)
        cost = _log_evidence(tables, chi_square, logdet)
        occam = float(torch.linalg.slogdet(precision).logabsdet) - n * math.log(UNIFORM)
        covariance = torch.linalg.inv(precision)
        minima.append(
            TableFit(
                change, gone, model, place, covariance, posed.predicted(place), lower @ slope, chi_square,
                cost + occam, cost, posed,
            )
        )  # fmt: skip
    minima = _apart(minima)
    least = min(one.evidence for one in minima)
    together = least - 2 * math.log(sum(math.exp(-0.5 * (one.evidence - least)) for one in minima))
    peaks = tuple(Peak(one.place, one.covariance) for one in minima)
    return replace(min(minima, key=lambda one: one.evidence), evidence=together, peaks=peaks)


def integrated(fit: TableFit, generator: torch.Generator, settings: ChangeSettings) -> TableFit:
    """The same, its likelihood integrated over the whole box."""
    posed = fit.posed
    assert posed is not None
    assert fit.change is not None
    common = _by_common(posed.tables, fit.change, fit.gone, fit.model, fit.place)
    found = integrate(functools.partial(posed.cost, common=common), fit.peaks, generator, settings.drawing)
    return replace(fit, evidence=found.evidence)


def theta_of(tables: Tables) -> Float[Tensor, " n"]:
    """The common parameters as the reference has left them."""
    return torch.tensor([tables.before[name] for name in tables.model.names]).to(tables.model.known)


def _apart(minima: Sequence[TableFit]) -> list[TableFit]:
    """Each minimum once: what is near to a better one, in the posterior's own metric, is that one."""
    kept: list[TableFit] = []
    for one in sorted(minima, key=lambda one: one.evidence):
        off = [one.place - other.place for other in kept]
        if all(
            float(d @ torch.linalg.solve(other.covariance, d)) > TABLE.same for d, other in zip(off, kept, strict=True)
        ):
            kept.append(one)
    return kept


def _by_common(
    tables: Tables, change: Change | None, gone: bool, whole: PlateModel, place: Float[Tensor, " n"]
) -> Float[Tensor, "n_mode n_mode"]:
    """G C Gᵀ, beside a change or none."""
    own = "" if change is None else change.name
    names = [name for name in tables.model.names if name != own and name in tables.after.names]
    if not names:
        return torch.zeros_like(tables.variance)
    kept = [tables.model.names.index(name) for name in names]
    covariance = tables.covariance[kept][:, kept]
    changed, plain = (tables.model, tables.after) if gone else (tables.after, tables.model)
    values = whole.as_dict(whole.space.to_si(place))
    others = frozen(tables, None, not gone)
    step = 1e-4

    def logs(model: PlateModel, values: Mapping[str, float]) -> Tensor:
        theta = torch.tensor([values[name] for name in model.names]).to(model.known)
        base = model.space.to_cube(theta)
        index = [model.names.index(name) for name in names if name in model.names]
        moved = base.repeat(1 + len(index), 1)
        for row, column in enumerate(index):
            moved[1 + row, column] += step if float(base[column]) < 0.5 else -step
        found = log_frequency(model, model.space.to_si(moved), tables.mode)
        signs = torch.tensor([1.0 if float(base[column]) < 0.5 else -1.0 for column in index]).to(base)
        return (found[1:] - found[0]) * signs[:, None] / step

    slope = logs(changed if change is None else change.applied(changed), values) - logs(
        plain, others.as_dict(others.known.new_zeros(0))
    )
    return slope.mT @ covariance @ slope
