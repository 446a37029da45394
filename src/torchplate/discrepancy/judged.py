"""How well noise and nuisances are known, and how well residuals agree with them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy.specimen import Found


class Judged(NamedTuple):
    """How well residuals agree with noise and nuisances.

    Attributes:
        cost: −2 ln of their likelihood times the priors of the scales, less what noise alone at κ = 1 has of constants.
        noise_scale: κ: what the noise is over what it was estimated as [-].
        scale: what each group of nuisances is over what was said of it [-].
        white: mean square of the residuals over noise and nuisances, these as large as in the marginal [-].
        n: real numbers behind it.
        shift: posterior means of the nuisances in their standard deviations.
        second_order: part of the variance of a number that the second order of the nuisances makes, on the mean [-].
        found: the specimen, where it is among the nuisances.
        complexity: the part of the cost that is not the data's: how improbable nuisances of the size found are, and how
            well the data know them.
    """

    cost: float
    noise_scale: float
    scale: Mapping[str, float]
    white: float
    n: float
    shift: Float[Tensor, " n_nuisance"]
    second_order: float = 0.0
    found: Found | None = None
    complexity: float = 0.0


@dataclass(frozen=True)
class Knowledge:
    """How well scales are known: degrees of freedom of their scaled inverse χ² priors.

    A variance known from k numbers has k; its logarithm's standard deviation is √(2/k).

    Args:
        noise: of the noise's variance: it is estimated from hundreds of lines, and its shape is a model: 10 %.
        told: of a nuisance whose size the config tells: to a third.
        untold: of one that has its default: to a factor of three.
    """

    noise: float = 200.0
    told: float = 6.0
    untold: float = 1.0
