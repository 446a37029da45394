"""What is taken for granted where two tests of one plate are compared."""

from dataclasses import dataclass, field

from torchplate.diagnosis.integral import Drawing


@dataclass(frozen=True)
class ChangeSettings:
    """How free a model is beside its reference, how far a plate may drift, and what is tried.

    Args:
        mode_stiffness: standard deviation of ln f of each mode about the model, the same in all tests [-]: what real
            supports, sensors and materials leave of a plate model, 10 % of stiffness or mass.
        mode_damping: of each mode's ln damping about its law, likewise [-]: no law hits every mode within a half.
        shape: relative error of what a change does to a mode, over how far the model misses the modes [-]. A stiffness
            that is off by 2b of a mode's mixes it with a neighbour Δλ away by 2b λ/Δλ, and what a change does there
            goes with the square of the deflection: 4b λ/Δλ, and neighbours are about one eigenvalue away.
        mesh: of what two meshes say differently of a mode's frequency once a section has changed, the part that is left
            when it is taken off [-]. Richardson takes an error for one of h². At the corners of a patch moments are
            singular, and it goes with an order between 1 and 2: for h he takes off 4/3 of a difference of which 2 are
            missing. What is left is anything from nothing to a half of what was taken off, 1/√12 in the mean square.
        near: modes that are this close, relative to the higher eigenvalue, turn into each other by what is left [-]:
            others by less than five times the part that it moves them.
        drift_all: of ln f of all modes alike from test to test [-]: two kelvin in a metal, d ln f / dT = -2.4e-4.
        drift_mode: of each mode's own ln f from test to test [-]: cables, and a plate hung up again.
        drift_damping: of each mode's ln damping from test to test [-], likewise.
        most: changes that are named, at most [-].
        most_of_table: the same from natural frequencies alone, of which each change takes one or more [-].
        n_refit: changes that are refitted, those that promise most [-].
        n_start: starts of each at the sharp level [-].
        n_grid: values of a parameter's interval that are tried [-].
        n_library: places and sizes of an effect that are tried on a table [-].
        n_turn: times that the reference's uncertainty is taken anew about where a fit has come to [-].
        n_settled: times that what is about to be integrated is taken about where it was found, at most [-].
        n_ahead: steps from there by the same columns, at most [-]: in a narrow valley of sharp peaks each takes off a
            tenth of what is left, and a way that ends before it rests ends where rounding says.
        n_damped: times that one of these steps is shortened tenfold before there is none [-].
        rest: a move on the unit cube below which it has come to rest [-].
        drawing: by which a likelihood is integrated.
        level: with this probability the best of all that is tried takes no more than is asked where nothing changed
            [-].
    """

    mode_stiffness: float = 0.05
    mode_damping: float = 0.5
    shape: float = 5.0
    mesh: float = 12**-0.5
    near: float = 0.2
    drift_all: float = 5e-4
    drift_mode: float = 2e-4
    drift_damping: float = 0.05
    most: int = 2
    most_of_table: int = 3
    n_refit: int = 8
    n_start: int = 3
    n_grid: int = 9
    n_library: int = 64
    n_turn: int = 3
    n_settled: int = 8
    n_ahead: int = 48
    n_damped: int = 8
    rest: float = 1e-4
    drawing: Drawing = field(default_factory=Drawing)
    level: float = 0.99


SETTINGS = ChangeSettings()
