"""What natural frequencies alone say of each effect, where FRFs are to be fitted and their peaks do not overlap."""

from collections.abc import Sequence
from typing import NamedTuple

from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.table.comparison import Comparing, Weighed
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.settings import SETTINGS, TableSettings
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel


class Single(NamedTuple):
    """One effect, fitted to natural frequencies.

    Attributes:
        name: of the effect.
        own: its parameters.
        others: the model's own that natural frequencies can see.
        left: χ² with it, over that of the model alone [-].
    """

    name: str
    own: dict[str, float]
    others: dict[str, float]
    left: float


def singles(
    model: PlateModel, table: NaturalFrequencies, prior: Prior, settings: TableSettings = SETTINGS
) -> Sequence[Single]:
    """Each effect alone, those that leave least first.

    Args:
        model: the model as it is believed; its searched parameters are fitted.
        table: what was measured.
        prior: what is known of its parameters beforehand.
        settings: constants.
    """
    bench = Comparing(
        Plates.corrected(model, TableEvidence.of(table, settings), settings), prior, settings, lambda _: None
    )
    baseline, fitted = bench.baseline()
    found = bench.singles(baseline, fitted)
    seen = bench.plates.reduced(bench.plates.model).seen
    shown = [bench.plates.model.names[k] for k in seen]
    before = max(baseline.best.chi_square, 1e-300)

    def as_single(one: Weighed) -> Single:
        assert one.hypothesis is not None
        values = one.model.as_dict(one.theta)
        label = one.hypothesis.labels[0]
        own = {key: values[f"{label}.{key}"] for key in one.hypothesis.parts[0].candidate.searched}
        return Single(
            one.hypothesis.parts[0].name,
            own,
            {name: values[name] for name in shown if name in values},
            one.best.chi_square / before,
        )

    return sorted(map(as_single, found.weighed), key=lambda one: one.left)
