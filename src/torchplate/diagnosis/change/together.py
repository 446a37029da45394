"""Changes of one kind that came together: several masses that were lightened, several springs that went soft.

What wears, loosens or is taken off seldom does so at one place only. One of several explains a part, and an effect with
a place of its own, free to sit anywhere, explains more of what all of them did: adding one change after another starts
with a false name, and does not come back. So sets of changes of the same parameter of effects of the same kind are
hypotheses of their own, with one name's share of the prior between them; a set grows from the best smaller ones.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.change.changes import Change
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.change.table_fit import TableFit, Tables, fitted
from torchplate.model import PlateModel


@dataclass(frozen=True)
class Together(Change):
    """Several changes of one kind; its candidate is the last of them, beside which the others are searched.

    Attributes:
        members: the changes.
    """

    members: tuple[Change, ...] = ()

    def applied(self, model: PlateModel) -> PlateModel:
        """The model with all of them; their parameters are searched."""
        for one in self.members:
            model = one.applied(model)
        return model

    def frees(self, names: Sequence[str]) -> list[str]:
        """Parameters that the reference says nothing of any more."""
        changed = {one.name for one in self.members}
        return [name for name in names if name in changed]


def kind_of(change: Change, model: PlateModel) -> str:
    """The effect and the parameter that a change is of; empty where it is no parameter's."""
    if change.candidate is not None or change.label not in model.effects:
        return ""
    return f"{model.effects[change.label].name}.{change.name.rpartition('.')[2]}"


def fitted_together(tables: Tables, singles: Sequence[TableFit], most: int, settings: ChangeSettings) -> list[TableFit]:
    """Sets of changes of one kind, fitted.

    Args:
        tables: what they are fitted to.
        singles: changes alone, fitted.
        most: changes of a set, at most.
        settings: what is taken for granted.
    """
    found: list[TableFit] = []
    own = [fit for fit in singles if fit.change is not None and not fit.gone]
    for kind in sorted({kind_of(fit.change, tables.after) for fit in own if fit.change is not None} - {""}):
        alone = [fit for fit in own if fit.change is not None and kind_of(fit.change, tables.after) == kind]
        changes = {fit.change.name: fit.change for fit in alone if fit.change is not None}
        sizes = range(2, 1 + min(most, len(changes)))
        before: dict[tuple[str, ...], TableFit] = {(fit.change.name,): fit for fit in alone if fit.change is not None}
        for size in sizes:
            best = sorted(before, key=lambda names: before[names].evidence)[: settings.n_refit]
            sets = sorted({tuple(sorted({*names, one})) for names in best for one in changes.keys() - set(names)})
            # Sizes share the prior of the name evenly, and sets that of their size.
            n_option = len(sizes) * math.comb(len(changes), size)
            fits = {names: _fitted(tables, kind, [changes[one] for one in names], n_option, settings) for names in sets}
            before = {names: fit for names, fit in fits.items() if fit is not None}
            found += before.values()
    return found


def apart(tables: Tables, fit: TableFit) -> list[TableFit]:
    """The changes of a set one by one, each beside those before it; a single change as it is."""
    if not isinstance(fit.change, Together):
        return [fit]
    values = fit.model.as_dict(fit.model.space.to_si(fit.place))
    names = [one.name for one in fit.change.members]
    found = []
    for k, one in enumerate(fit.change.members):
        assert one.interval is not None
        index = fit.model.names.index(one.name)
        known = {name: value for name, value in values.items() if name != one.name}
        model = fit.model.replaced(known=known, searched={one.name: one.interval})
        # Those that come after are as they were before.
        later = [fit.model.names.index(name) for name in names[k + 1 :]]
        theta = fit.model.space.to_si(fit.place)
        back = theta.clone()
        back[later] = torch.tensor([tables.before[fit.model.names[at]] for at in later]).to(theta)
        moved = fit.slope[:, later] @ (fit.place - fit.model.space.to_cube(back))[later]
        single = replace(
            fit, change=one, model=model, place=fit.place[index : index + 1],
            covariance=fit.covariance[index : index + 1, index : index + 1], slope=fit.slope[:, index : index + 1],
            predicted=fit.predicted - moved,
        )  # fmt: skip
        found.append(single)
    return found


def _fitted(
    tables: Tables, kind: str, members: Sequence[Change], n_option: int, settings: ChangeSettings
) -> TableFit | None:
    last = members[-1]
    assert last.interval is not None
    others = {one.name: one.interval for one in members[:-1] if one.interval is not None}
    known = {name: value for name, value in tables.after.known_values.items() if name not in others}
    after = tables.after.replaced(known=known, searched=tables.after.searched | others)
    candidate = Candidate(after.effects[last.label], {}, {last.name.rpartition(".")[2]: last.interval}, {})
    change = Together(kind, last.label, candidate, n_option=n_option, members=tuple(members))
    return fitted(replace(tables, after=after), change, False, settings)
