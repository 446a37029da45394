"""What the best of all effects would take from χ² where nothing is missing: a parametric bootstrap, linearised.

Scatter is drawn with its unknown factor, the given model's parameters follow it, and every effect takes what it can at
the best of its places. Sources: Davison and Hinkley, Bootstrap Methods and their Application (1997), ch. 4; Gross and
Vitells, European Physical Journal C 70 (2010) 525, on the best of many places.
"""

import torch

from torchplate.diagnosis.table.comparison import Comparison
from torchplate.diagnosis.table.settings import TableSettings

# A change shorter than this says nothing [standard deviations]: its direction is rounding.
SHORT = 1e-3


def once_in_a_hundred(compared: Comparison, settings: TableSettings, seed: int = 0) -> float:
    """The fall of χ² that the best effect exceeds in one of a hundred draws; 0 where there is none."""
    evidence, fitted = compared.plates.evidence, compared.fitted
    directions = [part.change[part.change.norm(dim=-1) > SHORT] for part in compared.seen]
    if not sum(len(one) for one in directions):
        return 0.0
    direction = torch.cat(directions)
    direction = direction / direction.norm(dim=-1, keepdim=True)
    generator = torch.Generator().manual_seed(seed)
    count = settings.n_draw
    normal = torch.randn(count, direction.shape[-1], generator=generator, dtype=torch.float64)
    wide = torch.randn(count, round(evidence.freedom), generator=generator, dtype=torch.float64).square().sum(-1)
    kappa = (evidence.freedom / wide).sqrt()
    # What is known beforehand has no unknown factor.
    scale = torch.where(torch.arange(direction.shape[-1]) < evidence.n, kappa[:, None], 1.0)
    left = fitted.freed(normal * scale)
    return float((left @ direction.mT).square().amax(-1).quantile(0.99))
