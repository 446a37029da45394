"""Meshes, levels, and how one hypothesis is fitted."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Fineness:
    """A mesh, and what is left of its error once that is extrapolated.

    Args:
        least: elements, at least [-]; the mesh twice as fine is used for the extrapolation alone.
        part: of a natural frequency's mesh error that is left [-].
        shift: of a natural frequency that is left in any case, relative [-].
        shape: of `Meshes.shape` that is left [-].
        place: by which lines of equal deflection are off, in sides of an element [-]: what is left is of the second
            order in a side, and a deflection over its slope is a place.
    """

    least: int
    part: float
    shift: float
    shape: float
    place: float


@dataclass(frozen=True)
class Meshes:
    """Meshes, bases, and what they leave.

    Args:
        searching: where effects are looked for.
        settling: where the last model is settled: what `give` leaves of a mass of 4 % of 2.7 mm of steel is half a per
            cent at 400 Hz there, less than what such a mass is weighed by in a test.
        margin: modes kept in a basis, in multiples of the band's end [-].
        same_section: distance of two specimens, in standard deviations of all terms of their sections, up to which a
            basis of one holds the other: what of their modes is not in it goes with the distance, and a fifth of what a
            sheet is usually off leaves a twenty-fifth of its squares [-].
        roughly: the same of plates that are spread over a prior and seen beside the frequency axis alone [-]: what is
            left of modes beyond goes with (1/roughly)⁴ of what they give at rest, less than smoothing takes.
        corrected: modes whose mesh error is taken off, likewise [-]: what higher ones leave of theirs is of the second
            order in the size of the elements, and shows between resonances.
        n_kind: kinds of plates whose mesh errors are kept [-]: those of hypotheses that are fitted beside one another.
        rounding: what the basis and the solver leave, relative to the FRF [-].
        shape: what the mesh leaves of the modes' deflections and of the static flexibility, relative to the level
            around a line, at the low and at the high end of the band [-].
        give: how much more a place gives on a mesh than on the plate, in squares of an element's side over the rigidity
            [-]: 0.011 amid an element, 0.019 at a node, of plates on simple supports; see the tests.
        corner: how far off a corner of a hole ends on a mesh whose error is taken off, in sides of an element [-]: of
            holes of which other meshes have the sides as their lines; see the tests.
        lossy: how far off the middle of a patch that loses ends, the root of its area, and the ratio of its sides times
            that root, in sides of an element for a loss factor of 1 [-]: of patches of 0.4 and 0.1 beside a mesh that
            has their sides as its lines; see the tests.
        rib: how far off a rib ends, along it and across, in sides of an element, and its stiffness and mass, in parts
            of themselves for each EI / (D side) [-]: of ribs of EI 0.1 D √A beside a mesh three times as fine; see the
            tests.
    """

    searching: Fineness = Fineness(256, 0.02, 3e-5, 1.0, 2.5e-3)
    settling: Fineness = Fineness(2500, 0.01, 1e-5, 0.5, 1.7e-3)
    margin: float = 3.0
    same_section: float = 0.2
    roughly: float = 1.5
    corrected: float = 5.0
    n_kind: int = 8
    rounding: float = 5e-4
    shape: tuple[float, float] = (4e-4, 1.8e-3)
    give: float = 0.016
    corner: float = 0.03
    lossy: tuple[float, float, float] = (0.012, 0.11, 0.08)
    rib: tuple[float, float, float] = (0.045, 0.01, 0.006)


@dataclass(frozen=True)
class WideLevels:
    """The levels at which FRFs are looked at beside the frequency axis, from wide to narrow; the sharp one comes last.

    Args:
        widths: how far beside it, relative to the frequency [-].
        n_iteration: of least squares at each [-]: enough to see which starts lead somewhere.
        tolerance: relative fall of the sum of squares at which it has come to rest [-].
        damping: of its first step [-].
        per_width: lines that are looked at for each half-width [-].
        most: lines that are looked at, at most [-].
        lowest: the first of them is no lower than this part of the last [-].
        around: the level around a line is taken over this part of its frequency on either side [-].
        most_mixed: FRFs that are looked at, at most [-]: more are mixed to so many.
        told: a parameter off by its standard deviation weighs as much as this part of all that is measured [-].
        screened: the level at which candidates are scored where peaks do not overlap, counted from 0 [-].
        as_measured: whether a line counts no more than what was measured there [-].
    """

    widths: tuple[float, ...] = (0.05, 0.02, 0.007)
    n_iteration: tuple[int, ...] = (3, 4, 6)
    tolerance: float = 1e-2
    damping: float = 1e-2
    per_width: float = 1.3
    most: int = 350
    lowest: float = 0.01
    around: float = 0.08
    most_mixed: int = 10
    told: float = 0.05
    screened: int = 1
    as_measured: bool = False


@dataclass(frozen=True)
class Fitting:
    """The fit of one hypothesis at the sharp level.

    Args:
        n_iteration: of least squares [-].
        tolerance: relative fall of the sum of squares at which it has come to rest [-].
        n_together: of several starts the best goes on alone after so many of them [-].
        damping: of the first steps [-].
        n_refused: times that a descent all of whose steps were refused goes on with more damping [-]: 5 refusals are a
            factor of 2¹⁵, and 2³⁰ above the least first damping a step is as short as it needs to be.
        near: of the parts that follow one that led near [-]: where parameters and specimen together change FRFs by a
            thousandth of what each does alone, a step is still whole.
        free: of those at the end, where something is known beforehand [-]: valleys that only this makes unlevel are
            long.
        n_basis: bases built for one fit [-].
        settled: relative change of the misfit at which the last basis is good [-].
        falling: where the misfit still falls to this part with each basis [-], there are more of them: nuisances are
            linear about where each begins. A drift between two tests is followed as long, too.
        most_bases: built then, at most [-].
        n_settled: times that a fit goes on beside nuisances as they are found [-].
        smaller: part of what was said that a nuisance has to be for that [-].
        moved: or part of a peak's width by which the section has to move a mode [-].
        little: fall of −2 ln L that is worth no further time [-].
        n_way: parts of the way of parameters and specimen together, at most [-]: linear nuisances anew at each.
        hoped: parts that may each lead as far as the last did [-]: falls shrink on the way to a minimum.
        parts: of each that are tried, one after another, until one leads down [-].
        longest: parts that a way which goes on as it began is taken at once, doubled up to this [-]: one ends where a
            drift is no longer linear, about a tenth of its standard deviation, and so many reach beyond one.
        far: part of the misfit by which it has to fall for the variance to stay as it is [-].
        lost: times the variance of the noise that is left from which on ways may lead round and round [-]: more is
            left than is noise.
        patience: parts in which such a way has to become more probable by `far` of what it is off [-].
        still: part by which FRFs may move before what a specimen does to them is found anew [-]: a step of least
            squares errs by no more than its Jacobian.
        farthest: a term of a section, a channel or a drift is put into the model with so many standard deviations at
            most [-]: a twentieth of its thickness.
    """

    n_iteration: int = 12
    tolerance: float = 1e-4
    n_together: int = 5
    damping: float = 1e-3
    n_refused: int = 2
    near: float = 1e-6
    free: float = 1e-9
    n_basis: int = 3
    settled: float = 2e-2
    falling: float = 0.85
    most_bases: int = 8
    n_settled: int = 4
    smaller: float = 0.5
    moved: float = 0.3
    little: float = 1.0
    n_way: int = 12
    hoped: int = 4
    parts: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.03)
    longest: float = 16.0
    far: float = 0.1
    lost: float = 2.0
    patience: int = 3
    still: float = 0.05
    farthest: float = 10.0


@dataclass(frozen=True)
class Searching:
    """The box that is searched, and the basins in it.

    Args:
        reach: how far a number that is known may leave its value, in standard deviations [-].
        least: what must stay above zero stays above this part of itself [-].
        n_spread: members spread over the box [-]; over the box and a prior together twice as many.
        n_descend: those that go down from there [-].
        n_basin: basins that are fitted to their end [-].
        same: ends of the wide levels that lie nearer on the unit cube are one basin [-].
        hopeless: what leaves so many times as much as the best so far is not followed to its end [-].
        wide_prior: an effect of the whole plate whose prior spans more than this factor [-] is looked for all over its
            prior and the box together, where the model is doubted.
        n_far: members that go down then [-].
        n_plates: members whose modes make the basis then, beside where it starts [-]: natural frequencies of 99 in 100
            are within the narrowest of the wide levels then.
        n_kept: ends of them that are kept [-].
    """

    reach: float = 5.0
    least: float = 0.1
    n_spread: int = 96
    n_descend: int = 12
    n_basin: int = 4
    same: float = 0.05
    hopeless: float = 4.0
    wide_prior: float = 10.0
    n_far: int = 16
    n_plates: int = 2
    n_kept: int = 3
