"""What is looked at of a test, how hypotheses about it are compared, and where its misfit is said to sit."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Comparison:
    """How hypotheses are compared.

    Args:
        missing: prior probability that anything is missing [-]: nobody knows beforehand.
        beyond: of what is missing, the part that no effect of the catalogue describes [-]: one in fifty of the faults
            that a test engineer meets, so that no name is ever surer than that.
        slip: prior probability that a number which was told with its standard deviation is off by far more [-]: records
            hold one to ten gross errors in a hundred numbers (Hampel et al., Robust Statistics, 1986, section 1.2).
        misspecified: relative entropy per number by which the model of noise and nuisances may be wrong [-]. A variance
            that is off by 2 % costs 0.02²/4 of it. So no test counts more than 10,000 independent numbers (Miller and
            Dunson, Robust Bayesian inference via coarsening, J. American Statistical Association 114, 2019, 1113).
        credible: probability of the set of equivalents [-].
        faint: a rival with less than this part of the probability of a name is not asked after again [-]:
            probabilities are told to 1 %.
        noise_limit: what is left is noise up to so many times its variance [-]: three standard deviations of a variance
            that is known from 200 numbers (`Knowledge.noise`).
        size_limit: nuisances may be so many times what was told of them, or taken for granted [-]: a standard deviation
            that a person gives is good to a factor of three.
        absurd: beyond so many times what was told, by how much says nothing [-]: a millimetre becomes a decimetre, half
            a per cent a half, and no test has that.
        finer: confidence in a finer mesh, where the evidence is for it [-]: what else it could be was not asked.
        on_bound: a uniform prior puts this part of itself as near to its ends as counts as on them [-].
    """

    missing: float = 0.5
    beyond: float = 0.02
    slip: float = 0.05
    misspecified: float = 1e-4
    credible: float = 0.95
    faint: float = 0.01
    noise_limit: float = 1.3
    size_limit: float = 3.0
    absurd: float = 100.0
    finer: float = 0.99
    on_bound: float = 2e-3


@dataclass(frozen=True)
class Lines:
    """How many lines of a large test are looked at; noise is estimated from all.

    Args:
        most_numbers: real numbers of all FRFs together, at most [-]: as many as any test counts as
            (`Comparison.misspecified`).
        per_mode: lines that are kept for each mode in the band in any case [-]: of each a frequency, a damping and a
            deflection are asked for, and what is between them.
        least: lines that are kept where nothing is known of the resonances [-]: ten for each of forty.
    """

    most_numbers: int = 10_000
    per_mode: int = 10
    least: int = 400


@dataclass(frozen=True)
class HoldingOut:
    """FRFs that no fit sees.

    Args:
        part: of the FRFs [-]: a fifth checks a fit and costs it little.
        few: fewer FRFs than so many [-] can spare none, and do not say where a fault sits or that nothing of the
            catalogue explains them.
        outlier: an FRF whose misfit is so many times the median's, and what is expected, disagrees with all others
            [-]: it is exchanged if it is held out, since what ails it alone must be seen to be found.
        one_in: such FRFs are one in so many at most [-]; where there are more, it is the model that disagrees.
    """

    part: float = 0.2
    few: int = 3
    outlier: float = 4.0
    one_in: int = 3


@dataclass(frozen=True)
class Localising:
    """Where the misfit is said to sit.

    Args:
        n_place: places along each side of the map [-].
        n_peak: peaks of the map at which the kind is looked at [-].
        below: how far below the highest they may be [-].
        n_band: bands that are named [-].
        in_bands: part of the misfit that they are to hold [-].
        n_line: lines of the moving mean, and between two bands [-].
        beyond_noise: a misfit this much above what noise makes is a misfit [-].
        named: a force that explains this part of the misfit is named [-].
        named_factor: likewise a factor [-]: half can be had by turning down what sits at wrong frequencies.
        near: parts of the misfit that differ by less are not told apart [-].
        nearly_all: a force that explains less than this part is said to leave something [-].
        longest_delay: that is tried [s].
    """

    n_place: int = 13
    n_peak: int = 5
    below: float = 0.15
    n_band: int = 5
    in_bands: float = 0.8
    n_line: int = 3
    beyond_noise: float = 1.25
    named: float = 0.5
    named_factor: float = 0.7
    near: float = 0.03
    nearly_all: float = 0.85
    longest_delay: float = 0.01
