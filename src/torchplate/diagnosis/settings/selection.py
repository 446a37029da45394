"""What is tried, what of it is refitted, and which of that is added."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Trials:
    """What each candidate is tried at.

    Args:
        parts: of the way from the neutral value to the end of the prior [-].
        at_place: the same for what sits at a place [-]: its multiple of either sign follows from the residual.
        tangent: part of the prior for which a tangent is believed [-].
        believed: multiples of a step, of either sign, for which a linear change is believed [-].
        spread: parts of a prior without a neutral value inside it, and of the sides for a patch [-].
        places: along each side for what sits at a point, relative [-].
        sizes: of patches, relative [-].
        yields: of the springs of a held edge over the rigid ones [-].
        softer: the same where peaks overlap [-]; what ends stiffer has not yielded.
        rigid: stiffness of the springs that hold an edge over the upper end of what is searched along a free one [-]:
            what is left of the yielding shifts no frequency by 1e-4.
        slack: how much stiffer than its prior a support is tried relative to one that is slack [-].
        slackest: the same of what is fitted [-]: the ratio of two factors, each even from 0 to 2, is above 10 once in
            twenty times.
        near_node: a place found is taken for a node's or a support's if it is this near to it, relative to the plate
            [-].
        perhaps_node: and may be it if it is this near [-].
        left_out: or if it is within an ellipse that leaves out this part of the place's posterior [-].
        weakest: strength of the weakest of the members that are tried at a place already found, over the strongest [-]:
            two decades, in which the strengths of what tests have found lie.
        most_members: of all values together, of a candidate with several parameters [-].
        most_corners: likewise, of values half way to the ends [-].
    """

    parts: tuple[float, ...] = (0.04, 0.15, 0.5, 1.0)
    at_place: float = 0.2
    tangent: float = 0.3
    believed: tuple[float, float] = (-1.0, 2.5)
    spread: tuple[float, ...] = (0.1, 0.3, 0.5, 0.7, 0.9)
    places: tuple[float, ...] = (0.03, 0.19, 0.35, 0.5, 0.65, 0.81, 0.97)
    sizes: tuple[float, ...] = (0.15, 0.35)
    yields: tuple[float, ...] = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 1e-5)
    softer: float = 0.1
    rigid: float = 100.0
    slack: float = 2.0
    slackest: float = 5.0
    near_node: float = 0.012
    perhaps_node: float = 0.04
    left_out: float = 0.01
    weakest: float = 0.01
    most_members: int = 60
    most_corners: int = 81


@dataclass(frozen=True)
class Screening:
    """Which of the candidates are refitted.

    Args:
        overlapping: gap below which peaks of model and measurement overlap [-].
        nearly_right: mean square of what is left below which wide levels would show but noise [-].
        n_wide: candidates, by name, that go down the wide levels [-].
        n_sharp: and that are refitted sharply [-].
        near: of a level those go on that leave no more than so many times as much as the best [-].
        faint: what promises less than this part of the best is not refitted [-].
        second: a second option of the same effect is followed if it promises this part of the first's [-].
        kept: what was refitted kept the promise where it took this part of it [-]; wide levels are not asked then, if
            little is left.
        n_rearranged: exchanges and turns of channels that are followed [-]: a further one promises less.
        n_start: starts of one candidate for its refit [-].
        apart: how far apart they must sit, relative to the plate [-]: about as places that are tried do.
        parallel: cosine from which on signatures are parallel [-].
        most_numbers: real numbers at which candidates are scored where more than noise is left, at most [-]: they tell
            parts of a misfit, which are means over lines, to 1/√6000.
        per_mode: lines that are kept for each mode in the band in any case [-]: each is seen, at some of its peak or
            beside it.
        n_draw: of what chance alone makes [-].
        level: part of the draws that chance may exceed [-].
        moved: how far what is missing moves a natural frequency [-]: few effects that show move one by more than twice
            that.
        missed: part of the modes that a test misses [-]: those that have a node at each sensor, or at each hit. As many
            poles are none.
    """

    overlapping: float = 0.5
    nearly_right: float = 2.5
    n_wide: int = 8
    n_sharp: int = 5
    near: float = 6.0
    faint: float = 0.05
    second: float = 0.6
    kept: float = 0.9
    n_rearranged: int = 8
    n_start: int = 8
    apart: float = 0.15
    parallel: float = 0.98
    most_numbers: int = 6000
    per_mode: int = 6
    n_draw: int = 200
    level: float = 0.01
    moved: float = 0.05
    missed: float = 0.1


@dataclass(frozen=True)
class Selecting:
    """Which effects are added, and what is looked for beside them.

    Args:
        doubtful: mean square up to which what is left may be chance or the mesh [-]; where the model as such is
            doubted, its error is inflated until that much is left.
        far_off: mean square beyond which it is doubted, where there are few FRFs [-]: several FRFs say plainly that
            nothing of the catalogue explains them.
        small_gap: gap below which what closed it may have been the mesh, in noise floors [-].
        nothing: standard errors within which the numbers of an effect may be those that change nothing, so that it has
            to show again; and beyond which a support at the place of a spring or dashpot says that its fit had stopped
            short [-]: chance lets the best of a catalogue take the square of that from −2 ln L.
        n_best: the best so many are followed where one alone may be wrong [-].
        explains_much: what leaves at most this part of the sum of squares explains much of it [-].
        explains_some: what leaves at most this part of the gap, or of the sum of squares where it has no number to be
            fitted, explains so much that another effect is looked for beside it [-].
        halved: what leaves at most this part of the gap, sharp or where peaks overlap, keeps its name beside an
            inflated error [-]: a convention, for no odds part it from what stands in (docs/real_plates.md).
        shows: what leaves at most this part of the gap shows [-].
        much_less: a pair that leaves at most this part of what its first effect does is judged again at once, and an
            effect that leaves at most this part of what natural frequencies have without it is refitted to FRFs [-]:
            frequencies are known to a part of what effects that show move them by.
        beside: a second effect is looked for beside the second best too, if that leaves no more than so many times as
            much [-].
        enough: but not once so many members were evaluated [-]: it seldom is worth as long again. Nor is a third effect
            beside two that leave far more than noise, nor two that promise much where two were looked for already.
        stopped_soon: a baseline that ends lower by this part than it did had stopped too soon [-].
        n_again: what came near in the ranking before and is tried again, so many at most [-].
        n_run_off: times that those close to the best are refitted from where they ended [-].
        close: in −2 ln L beside the best [-].
        close_part: and in parts of its sum of squares [-].
        little: mean square up to which little is left, so that a support that stays where it is may be named [-].
        grounded: mean square beyond which nothing is asked of a support [-].
        n_rival: rivals of an earlier name that are tried in its place [-]: those that came nearest when it was named;
            where far more than noise is left, half of them are those that promise most beside the other names.
        hopeless_rival: one that leaves so many times as much as the last model is not followed to its end [-].
    """

    doubtful: float = 12.0
    far_off: float = 20.0
    small_gap: float = 3.0
    nothing: float = 5.0
    n_best: int = 2
    explains_much: float = 0.5
    explains_some: float = 0.75
    halved: float = 0.5
    shows: float = 0.9
    much_less: float = 0.1
    beside: float = 2.0
    enough: int = 9000
    stopped_soon: float = 0.04
    n_again: int = 3
    n_run_off: int = 3
    close: float = 100.0
    close_part: float = 0.03
    little: float = 3.0
    grounded: float = 300.0
    n_rival: int = 4
    hopeless_rival: float = 10.0
