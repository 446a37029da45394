"""What natural frequencies alone say is missing, where FRFs are to be fitted and their peaks do not overlap."""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.table.comparison import Comparing, Comparison, Weighed
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.settings import SETTINGS, TableSettings
from torchplate.measurement import NaturalFrequencies
from torchplate.model import PlateModel


class Told(NamedTuple):
    """One effect or two, fitted to natural frequencies.

    Attributes:
        names: of the effects.
        options: of each.
        own: parameters of each.
        others: the model's own that natural frequencies can see.
        left: χ² with them, over that of the model alone [-].
        evidence: −2 ln Z.
    """

    names: tuple[str, ...]
    options: tuple[Mapping[str, Any], ...]
    own: tuple[dict[str, float], ...]
    others: dict[str, float]
    left: float
    evidence: float


class Asked:
    """Each effect and the pairs that promise most, fitted when they are asked for.

    Args:
        model: the model as it is believed; its searched parameters are fitted.
        table: what was measured.
        prior: what is known of its parameters beforehand.
        settings: constants.
    """

    def __init__(
        self, model: PlateModel, table: NaturalFrequencies, prior: Prior, settings: TableSettings = SETTINGS
    ) -> None:
        plates = Plates.corrected(model, TableEvidence.of(table, settings), settings)
        self.model, self.table = model, table
        self._comparing = Comparing(plates, prior, settings, lambda _: None)

    @functools.cached_property
    def singles(self) -> list[Told]:
        """Each effect alone, those that leave least first."""
        return sorted(map(self._told, self._alone.weighed), key=lambda one: one.left)

    @functools.cached_property
    def pairs(self) -> list[Told]:
        """Two effects, the most probable first."""
        weighed = [one for one in self._comparing.with_pairs(self._alone).weighed if len(one.names) > 1]
        return sorted(map(self._told, weighed), key=lambda one: one.evidence)

    @functools.cached_property
    def _alone(self) -> Comparison:
        return self._comparing.singles(*self._comparing.baseline())

    def _told(self, one: Weighed) -> Told:
        assert one.hypothesis is not None
        plates, before = self._comparing.plates, max(self._alone.baseline.best.chi_square, 1e-300)
        seen = plates.reduced(plates.model).seen
        values = one.model.as_dict(one.theta)
        labels, every = one.hypothesis.labels, [part.candidate for part in one.hypothesis.parts]
        own = tuple(
            {key: values[f"{label}.{key}"] for key in candidate.searched}
            for label, candidate in zip(labels, every, strict=True)
        )
        options = tuple(candidate.options for candidate in every)
        others = {name: values[name] for name in (plates.model.names[k] for k in seen) if name in values}
        return Told(one.names, options, own, others, one.best.chi_square / before, one.evidence)
