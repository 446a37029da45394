"""How a field is inferred where nothing of the catalogue accounts for what is left."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FieldInference:
    """Of a field of stiffness, mass, loss or support.

    Args:
        n_side: nodes along the side of a square plate [-]: some forty values, as many as the modes of a usual band say;
            on others as many in all.
        square: sides that differ by less than this part are equal [-]: the image turned by a right angle is fitted
            before it is told, so that a wrong guess costs a step and no truth.
        most_numbers: real numbers that are looked at [-]: a map of forty values is not sharper with more.
        least_lines: that are kept in any case [-]: some ten for each mode of a band with twenty.
        relative: standard deviation of a node's value before anything is seen, of rigidity and mass over the plate's
            [-], at the wide levels.
        loss: likewise of its loss factor [-].
        support: likewise of its spring, in multiples of the plate's own scale D/A [-].
        least: of the plate's rigidity and mass is left anywhere [-]: less is a hole.
        bumps: single values that are tried at each node, in these standard deviations [-]: halved, doubled, and more.
        n_force: nodes from which a force at one place is followed [-]: the best of them, and three in case its place
            lies in a valley of another.
        n_force_step: steps that it takes at most [-]: Gauss and Newton's, which double its digits near the end.
        force_falls: part of what is left that a step has to promise, or it has arrived [-]: a hundredth of the
            difference that a thousand numbers make out.
        n_bump: of them, the best so many are gone on from, beside no field [-].
        step: a value goes so many of these standard deviations in one step at most [-].
        own_step: a parameter of the model itself goes this part of its interval in one step at most [-]: about the
            standard deviation of a uniform prior, 1/√12.
        unseen: what keeps in place what the data do not see, over the largest diagonal of JᵀJ [-]: a Jacobian by
            differences is good to 1e-6 of itself, its square to this.
        dampings: of a step that are tried, one after another, until one leads down [-].
        n_wide: steps at each wide level [-].
        level: part to which what is left has to fall at each, or the steps of a level end [-].
        n_sharp: steps at the sharp one, at most [-].
        n_all: those that each kind takes before one is chosen [-].
        patience: steps in which what is left has to fall [-].
        falling: to this part of it at least, or the steps end [-].
        n_fold: parts that the FRFs are divided into for cross-validation [-].
        spacing: length over which a smooth field goes together, in spacings of the nodes [-].
        alone: part of such a field's variance that each node has of its own [-].
        together: correlation of what a stiffness has along x, along y and in twist [-]: as much of a value is common to
            them as is its own.
        floor: of a sparse field the largest value times this is as good as zero [-].
        strengths: standard deviation of a value over that which noise leaves of one seen alone [-]: from, to, and how
            many a decade [log10, log10, 1].
        n_holding: times that values that would be negative are held at zero, at most [-]: each leaves fewer, and what
            is left of them after the last is cut off.
        holding: precision that holds them, over what the data have of a value on the mean [-]: a value held is one
            in so many of what it would be, which is as good as zero.
        wide: standard deviation about its centre, relative to the side, from which on a field has no one place [-]:
            that of a weight that is even over seven tenths of the side, 0.7/√12.
        helps: part of what is left of FRFs put aside, and of the gap of the held-out FRFs, that a field must take off
            [-].
        saturated: a gap beyond this need not fall by so much, but must not grow [-]: half of all power, 1/√2, is out of
            place there, and peaks that come nearer by less than their width leave it where it is.
        twin: a mirror image is a twin unless it is so many times less probable [-].
    """

    n_side: int = 7
    square: float = 0.01
    most_numbers: int = 6000
    least_lines: int = 200
    relative: float = 0.3
    loss: float = 0.02
    support: float = 100.0
    least: float = 0.05
    bumps: tuple[float, ...] = (-2.0, 3.0, 10.0)
    n_force: int = 4
    n_force_step: int = 25
    force_falls: float = 1e-5
    n_bump: int = 2
    step: float = 2.0
    own_step: float = 0.25
    unseen: float = 1e-12
    dampings: tuple[float, ...] = (0.0, 0.01, 0.1, 1.0, 10.0)
    n_wide: int = 5
    level: float = 0.98
    n_sharp: int = 20
    n_all: int = 4
    patience: int = 4
    falling: float = 0.9
    n_fold: int = 5
    spacing: float = 1.0
    alone: float = 0.2
    together: float = 0.5
    floor: float = 0.1
    strengths: tuple[float, float, int] = (-1.0, 4.0, 2)
    n_holding: int = 8
    holding: float = 1e9
    wide: float = 0.2
    helps: float = 0.1
    saturated: float = 0.7
    twin: float = 20.0

    def farthest(self, n_level: int) -> float:
        """How far a value can come from none, in its standard deviations [-]: the largest bump, and every step.

        Args:
            n_level: wide levels.
        """
        # One more step is that of a mirror image.
        n_step = self.n_wide * n_level + self.n_sharp + 1
        return max(map(abs, self.bumps)) + self.step * n_step
