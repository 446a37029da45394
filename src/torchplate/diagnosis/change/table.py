"""What has changed between two tables of natural frequencies: one change after another, as long as one is needed.

How a change is fitted, and what is compared, says `table_fit`.
"""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from torchplate.diagnosis.candidates.candidate import n_options
from torchplate.diagnosis.candidates.catalogue import candidates
from torchplate.diagnosis.candidates.channels import Channels
from torchplate.diagnosis.change.changes import Change, allowed, n_names, parameters_that_moved
from torchplate.diagnosis.change.posterior import Choice, Weighed, choose
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.change.table_fit import (
    TableFit,
    Tables,
    fitted,
    frozen,
    integrated,
    log_frequency,
    none_of,
    theta_of,
)
from torchplate.diagnosis.change.table_summary import summarise_tables
from torchplate.diagnosis.change.together import apart, fitted_together
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.result import Diagnosis
from torchplate.diagnosis.settings import Comparison
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.settings import SETTINGS as TABLE
from torchplate.diagnosis.tolerance import with_tolerances
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel, on_mesh, ritz_basis
from torchplate.plate import Assembly
from torchplate.search import JACOBIANS, least_squares

if TYPE_CHECKING:
    from torchplate.diagnosis.change.flow import PlateTest


@torch.no_grad()
def tables_changed(
    reference: "PlateTest",
    after: "PlateTest",
    *,
    own: Collection[str],
    seed: int,
    say: Callable[[str], object],
    settings: ChangeSettings,
) -> Diagnosis:
    """Find what has changed between two tables.

    Args:
        reference: the test before.
        after: the test after.
        own: parameters with a value of their own in each test.
        seed: of the draws by which likelihoods are integrated.
        say: is told what is being tried.
        settings: what is taken for granted.

    Raises:
        ValueError: if the tables have no mode in common.
    """
    began = time.monotonic()
    tables = _tables(reference, after, settings)
    tables = replace(tables, variance=tables.variance + _by_own(tables, own))
    comparison = Comparison()
    generator = torch.Generator().manual_seed(seed)
    first = none = none_of(tables)
    named: list[tuple[TableFit, Choice]] = []
    tried: list[list[TableFit]] = []
    while len(named) < settings.most_of_table:
        taken = {*own, *(fit.change.name for fit, _ in named if fit.change is not None and not fit.change.candidate)}
        changes = [change for change in _changes(tables, after) if change.name not in taken]
        say(f"{len(changes)} changes beside {none.chi_square:.4g} of {len(tables.mode)} frequencies")
        fits = [fit for change in changes for fit in _both_ways(tables, change, settings)]
        if not fits:
            break
        fits += fitted_together(tables, fits, settings.most_of_table - len(named), settings)
        fits = _within_reach(fits, generator, settings)
        tried.append(fits)
        weighed = [_weighed(fit, len(tables.mode)) for fit in fits]
        empty = Weighed(None, none.evidence, none.cost)
        choice = choose(empty, weighed, n_names(changes), len(fits), comparison, settings)
        if not choice.needed:
            break
        best = fits[next(k for k, one in enumerate(weighed) if one is choice.best)]
        named += [(one, choice) for one in apart(tables, best)]
        tables = _with_change(tables, best)
        none = none_of(tables)
        if none.chi_square <= limit(len(tables.mode), tables.freedom):
            break
    return summarise_tables(tables, first, none, named, tried, (reference, after), time.monotonic() - began)


def _both_ways(tables: Tables, change: Change, settings: ChangeSettings) -> list[TableFit]:
    """A change that came, and one that went where it may have been there before: two options of one name."""
    ways = (False, True) if _may_go(change) else (False,)
    one = replace(change, n_option=len(ways) * change.n_option)
    return [fit for gone in ways if (fit := fitted(tables, one, gone, settings)) is not None]


def _within_reach(fits: Sequence[TableFit], generator: torch.Generator, settings: ChangeSettings) -> list[TableFit]:
    """The same, those integrated over their boxes that may be the best or as good."""
    least = min(fit.evidence for fit in fits)
    return [integrated(fit, generator, settings) if fit.evidence < least + TABLE.far else fit for fit in fits]


def limit(n: int, freedom: float) -> float:
    """χ² of so many frequencies that scatter alone exceeds as seldom as the diagnosis of a table has it."""
    import scipy.stats  # here: a third of what importing this package takes

    return n * float(scipy.stats.f.ppf(TABLE.level, n, freedom))


def _with_change(tables: Tables, fit: TableFit) -> Tables:
    """The tables beside a change that was found, as uncertain as it was found and as the modes' shapes are."""
    numbers = fit.model.replaced(known=fit.model.as_dict(fit.model.space.to_si(fit.place)), searched={})
    # What is common is searched again.
    plain = tables.model if fit.gone else tables.after
    held = set() if fit.change is None else set(fit.change.frees(plain.names))
    back = {name: one for name, one in plain.searched.items() if name not in held}
    known = {name: value for name, value in numbers.known_values.items() if name not in back}
    changed = numbers.replaced(known=known, searched=back)
    slope = fit.slope
    variance = tables.variance + slope @ fit.covariance @ slope.mT
    if fit.posed is not None:
        variance = variance + torch.diag((fit.posed.shape * (fit.predicted - fit.posed.none)).square())
    if fit.gone:
        return replace(tables, model=changed, variance=variance)
    return replace(tables, after=changed, variance=variance)


def _weighed(fit: TableFit, n_mode: int) -> Weighed:
    assert fit.change is not None
    has_place = fit.change.candidate is not None and fit.change.candidate.has_place
    return Weighed(fit.change, fit.evidence, fit.cost, len(fit.place), 2 * n_mode if has_place else 1)


def _tables(reference: "PlateTest", after: "PlateTest", settings: ChangeSettings) -> Tables:
    assert reference.natural_frequencies is not None
    assert after.natural_frequencies is not None
    one, other = (TableEvidence.of(test.natural_frequencies, TABLE) for test in (reference, after))  # type: ignore[arg-type]
    mode = torch.tensor(sorted(set(one.mode.tolist()) & set(other.mode.tolist())), dtype=torch.int64)
    if not len(mode):
        raise ValueError("Expected a mode that both tables hold, got none. Number the modes alike.")
    first, second = (torch.tensor([table.mode.tolist().index(k) for k in mode.tolist()]) for table in (one, other))
    f_before, f_after = one.frequency[first], other.frequency[second]
    scatter = (one.scatter[first] / f_before).square() + (other.scatter[second] / f_after).square()
    variance = torch.diag(scatter + settings.drift_mode**2) + settings.drift_all**2
    given, prior = with_tolerances(reference.model, dict(reference.tolerance))
    later, _ = with_tolerances(after.model, dict(after.tolerance))
    model = _small(given, int(mode.max()) + 1)
    position, covariance = _common(model, prior, mode, f_before, one.scatter[first], settings)
    theta = model.space.to_si(position)
    freedom = min(one.freedom, other.freedom)
    off = f_before.log() - log_frequency(model, theta, mode)
    missed = min(float(off.square().mean().sqrt()), settings.mode_stiffness)
    return Tables(
        model,
        _small(later, int(mode.max()) + 1),
        model.as_dict(theta),
        covariance,
        mode,
        (f_after / f_before).log(),
        variance,
        freedom,
        missed,
    )


def _small(model: PlateModel, n_mode: int) -> PlateModel:
    """The model in a basis of its modes, three times as many as are wanted and ten."""
    theta = model.space.to_si(torch.full((1, len(model.names)), 0.5).to(model.known))
    wanted = min(3 * n_mode + 10, model.assembly.size)
    basis = ritz_basis(model, theta, None, wanted, 1.0)
    if basis.shape[-1] >= model.assembly.size:
        return model
    return on_mesh(model, Assembly(model.mesh, basis, True, model.assembly.correction))


def _common(
    model: PlateModel,
    prior: Mapping[str, tuple[float, float]],
    mode: Tensor,
    frequency: Float[Tensor, " n_mode"],
    std: Float[Tensor, " n_mode"],
    settings: ChangeSettings,
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n n"]]:
    """What the reference says of what is common, each mode off by its own number: a place on the cube, covariance."""
    n = len(model.names)
    if not n:
        return model.known.new_zeros(0), model.known.new_zeros(0, 0)
    weight = ((std / frequency).square() + settings.mode_stiffness**2).rsqrt()
    index = [k for k, name in enumerate(model.names) if name in prior]
    mean, spread = (model.known.new_tensor([prior[model.names[k]][part] for k in index]) for part in (0, 1))

    def residual(places: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_residual"]:
        theta = model.space.to_si(places)
        off = weight * (log_frequency(model, theta, mode) - frequency.log())
        return torch.cat([off, (theta[..., index] - mean) / spread], dim=-1)

    start = torch.cat([torch.full((1, n), 0.5).to(model.known), SobolEngine(n).draw(8, dtype=torch.float64)[1:]])
    ended = least_squares(residual, start, jacobian="forward", n_iteration=30)
    best = ended.position[ended.objective.argmin()]
    slope = JACOBIANS["forward"].differentiate(residual, best[None], residual(best[None]))[0]
    flat = torch.full((n,), UNIFORM).to(best)
    flat[index] = 0.0
    return best, torch.linalg.inv(slope.mT @ slope + torch.diag(flat))


def _changes(tables: Tables, after: "PlateTest") -> list[Change]:
    """All that a table can see."""
    model = tables.model
    theta = torch.tensor([tables.before[name] for name in model.names]).to(model.known)
    every = allowed(candidates(model, theta, Channels((), ()), None, after.tolerance.keys()), after.model)
    seen = [one for one in every if CATALOGUE[one.name].moves_natural_frequencies()]
    n_option = n_options(seen)
    effects = {**tables.model.effects, **tables.after.effects}
    found = [Change(one.name, _new_label(effects, one.name), one, n_option=n_option[one.cause]) for one in seen]
    values = {key: value for key, value in tables.before.items() if key in set(_numbers_of(tables))}
    moved = parameters_that_moved(model, (), values, after.tolerance.keys())
    return found + [one for one in moved if _is_seen(tables, one)]


def _new_label(effects: Collection[str], name: str) -> str:
    """A label that neither model has yet."""
    return next(label for k in range(1, 100) if (label := f"{name}_{k}") not in effects)


def _numbers_of(tables: Tables) -> list[str]:
    """Parameters that both models have."""
    return [*tables.after.names, *tables.after.known_values]


def _is_seen(tables: Tables, change: Change) -> bool:
    """Whether natural frequencies depend on a parameter."""
    model = frozen(tables, change)
    found = log_frequency(model, model.space.to_si(torch.tensor([[0.1], [0.9]]).to(model.known)), tables.mode)
    return float((found[0] - found[1]).abs().max()) > 1e-9


def _may_go(change: Change) -> bool:
    """Whether it may have been there before: a strength of one sign, at a place of its own."""
    one = change.candidate
    if one is None:
        return False
    return any(key in one.neutral and one.neutral[key] <= one.searched[key].low for key in one.searched)


def _by_own(tables: Tables, own: Collection[str]) -> Float[Tensor, "n_mode n_mode"]:
    """What parameters that have a value of their own may do anywhere in their intervals, to first order."""
    index = [k for k, name in enumerate(tables.model.names) if name in own]
    if not index:
        return torch.zeros_like(tables.variance)
    base = tables.model.space.to_cube(theta_of(tables))

    def along(places: Tensor) -> Tensor:
        return log_frequency(tables.model, tables.model.space.to_si(places), tables.mode)

    slope = JACOBIANS["forward"].differentiate(along, base[None], along(base[None]))[0][:, index]
    # Of the difference of two values, each anywhere in the interval.
    return 2 / UNIFORM * slope @ slope.mT
