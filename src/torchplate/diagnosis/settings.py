"""What a diagnosis takes for granted: every number that somebody chose, with its unit and its reason."""

from dataclasses import dataclass, field

from torchplate.discrepancy.marginal import Knowledge
from torchplate.discrepancy.wandering import Wandering


@dataclass(frozen=True)
class Comparison:
    """How hypotheses are compared.

    Args:
        missing: prior probability that anything is missing [-]: nobody knows beforehand.
        beyond: of what is missing, the part that no effect of the catalogue describes [-]: one in fifty of the faults
            that a test engineer meets, so that no name is ever surer than that.
        misspecified: relative entropy per number by which the model of noise and nuisances may be wrong [-]. A variance
            that is off by 2 % costs 0.02²/4 of it. So no test counts more than 10,000 independent numbers (Miller and
            Dunson, Robust Bayesian inference via coarsening, J. American Statistical Association 114, 2019, 1113).
        credible: probability of the set of equivalents [-].
        noise_limit: what is left is noise up to so many times its variance [-]: three standard deviations of a variance
            that is known from 200 numbers (`Knowledge.noise`).
        size_limit: nuisances may be so many times what was told of them, or taken for granted [-]: a standard deviation
            that a person gives is good to a factor of three.
        on_bound: a uniform prior puts this part of itself as near to its ends as counts as on them [-].
    """

    missing: float = 0.5
    beyond: float = 0.02
    misspecified: float = 1e-4
    credible: float = 0.95
    noise_limit: float = 1.3
    size_limit: float = 3.0
    on_bound: float = 2e-3


@dataclass(frozen=True)
class Lines:
    """How many lines of a large test are looked at; noise is estimated from all.

    Args:
        most_numbers: real numbers of all FRFs together, at most [-]: twice as many as any test counts as
            (`Comparison.misspecified`).
        least: lines that are kept in any case [-]: some ten for each mode of a band with forty.
    """

    most_numbers: int = 20_000
    least: int = 400


@dataclass(frozen=True)
class DiagnosisSettings:
    """All of them, by stage.

    Args:
        knowledge: how well noise and nuisances are known.
        wandering: of the plate's section.
        comparison: of hypotheses.
        lines: how many are looked at.
    """

    knowledge: Knowledge = field(default_factory=Knowledge)
    wandering: Wandering = field(default_factory=Wandering)
    comparison: Comparison = field(default_factory=Comparison)
    lines: Lines = field(default_factory=Lines)
