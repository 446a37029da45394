"""The constants of the diagnosis of a table, by stage, each with its unit and its reason."""

import math
from dataclasses import dataclass, field

from torchplate.diagnosis.integral import Drawing


@dataclass(frozen=True)
class TableSettings:
    """What is assumed and how far is searched.

    Attributes:
        freedom_told: degrees of freedom of the prior of κ², the one factor on all variances, where somebody told the
            standard deviations: 20 means that they are known to 16 %.
        freedom_assumed: the same where they are the default: 4 means that they may be half or twice as large.
        level: quantile of F beyond which what is left is more than scatter [-].
        prior_number: probability that no, one, two effects are missing [-].
        prior_given_mesh: probability that a table comes from the given mesh itself and not from a plate [-].
        set_probability: what the set of a name and its equivalents holds, and from which the corrected mesh is worth a
            name [-].
        least_part: an effect that leaves more than this part of χ², and more than scatter, explains nothing [-].
        volume: a parameter that is known to a on the unit cube (precision a) costs ½ ln(1 + a / volume). 2π is right at
            both ends: the Gaussian's own volume √(2π/a) where data say much, 1 where they say nothing.
        unseen: largest squared change over the prior box, in standard deviations, below which a table cannot see an
            effect [-].
        same: squared distance, in the posterior's own metric, below which two ends are one minimum [-].
        far: ends whose χ² term lies so much above the best are forgotten [-]: they would weigh e^(-far/2).
        mesh_part: part of a natural frequency's mesh error that stays once it is extrapolated [-].
        mesh_least: relative error of a natural frequency that stays on any mesh [-].
        alike: what agrees to this part of a standard deviation is one [-]: both meshes, of which one is tried then, and
            mirror images, which are one plate turned.
        most_doubtful: confidence in a name at most, without equivalents, whose parameter wants to leave its prior, or
            beside which more than scatter is left: what is missing there is in no hypothesis [-].
        n_element: least numbers of elements of the corrected mesh, the next where the last leaves too much.
        little: part of the scatter that a mesh may leave of its error [-].
        n_library: places at which an effect of one parameter is tried; of more, 4 and 8 times as many.
        n_start: starts of an effect's refit.
        n_pair: pairs that are refitted where no effect alone leaves nothing but scatter; those that promise most when
            their changes are added.
        n_pair_beside: the same where one does, or the given model: pairs then only share its probability.
        pairs_within: pairs are refitted on a mesh whose best is so near to the best of both, in −2 ln Z [-].
        hopeless: a refit whose best start leaves so many times the least χ² after these is not followed to its end: ten
            times that of one frequency's is a likelihood lower by a factor of e^18 and more [-].
        n_first: iterations of all starts, and of the last refit.
        n_anew: times that starts of a hole go so far, each in the modes of the plate that it was; after the first the
            nearest that go on [-].
        n_onward: starts that go on from there.
        n_iteration: of those.
        near: minima up to so much above the best, in −2 ln Z, are refitted in the end [-].
        n_rebuilt: refits that end in the modes of the plate they found, for each number of effects.
        basis_error: relative error of a natural frequency beyond which an effect's own modes join the basis [-].
        basis_times: modes of a basis over those of the table, so many times [-].
        basis_more: and so many more [-].
        basis_further: modes that a further plate brings, over the table's [-].
        n_spread: places over the box of the given model [-].
        n_best: those that go on from there [-].
        blind: an estimate that the data narrow by less than this part of its prior's precision has no standard
            deviation [-].
        n_worst: modes that are named where a table is left unexplained [-].
        n_draw: draws of the null distribution and of the posterior.
        doubtful: probability by Laplace's method from which on a hypothesis is integrated over all its values [-].
        drawing: by which it is.
    """

    freedom_told: float = 20.0
    freedom_assumed: float = 4.0
    level: float = 0.99
    prior_number: tuple[float, float, float] = (1 / 2, 3 / 8, 1 / 8)
    prior_given_mesh: float = 0.5
    set_probability: float = 0.95
    least_part: float = 0.5
    volume: float = 2 * math.pi
    unseen: float = 0.1
    same: float = 4.0
    far: float = 20.0
    mesh_part: float = 0.02
    mesh_least: float = 3e-5
    alike: float = 0.3
    most_doubtful: float = 0.9
    n_element: tuple[int, ...] = (100, 256)
    little: float = 0.3
    n_library: int = 16
    n_start: int = 6
    n_pair: int = 30
    n_pair_beside: int = 6
    pairs_within: float = 10.0
    hopeless: float = 10.0
    n_first: int = 5
    n_anew: int = 4
    n_onward: int = 3
    n_iteration: int = 12
    near: float = 6.0
    n_rebuilt: int = 8
    basis_error: float = 3e-4
    basis_times: float = 1.8
    basis_more: int = 12
    basis_further: int = 4
    n_spread: int = 64
    n_best: int = 4
    blind: float = 1e-3
    n_worst: int = 4
    n_draw: int = 400
    doubtful: float = 1e-3
    drawing: Drawing = field(default_factory=Drawing)


SETTINGS = TableSettings()
