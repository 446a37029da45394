"""What a least-squares search returns, and what it shows while it runs."""

from enum import Enum
from typing import NamedTuple

from jaxtyping import Float, Int
from torch import Tensor


class LeastSquaresStatus(Enum):
    """Why a start stopped; the value is the sentence for the user and ends in what to do."""

    gradient = (
        "No free parameter lowers the sum of squares to first order. "
        "Start elsewhere too to see whether this minimum is the lowest."
    )
    step = (
        "The steps have become shorter than the tolerance. "
        "Start elsewhere too to see whether this minimum is the lowest."
    )
    objective = (
        "The sum of squares has nothing left to fall, to within the tolerance. "
        "Start elsewhere too to see whether this minimum is the lowest."
    )
    stuck = (
        "No step, however short, lowers the sum of squares. "
        "Evaluate the gradient: where it is small this is a minimum; else mend the jacobian, or what makes it NaN."
    )
    budget = (
        "The budget is spent while the sum of squares still falls. "
        "Raise n_iteration or n_evaluation (in a config search.n_generation, search.n_evaluation), or start nearer to "
        "the minimum."
    )
    no_number = (
        "The residual or its jacobian is not a finite number at the start. "
        "Evaluate both there by hand and mend them, or start elsewhere."
    )

    @property
    def settled(self) -> bool:
        """Whether the start has found a minimum."""
        return self in {LeastSquaresStatus.gradient, LeastSquaresStatus.step, LeastSquaresStatus.objective}


class LeastSquaresOutcome(NamedTuple):
    """Where every start has come to.

    Attributes:
        position: The place on the unit cube; a parameter on its bound is exactly 0 or 1.
        objective: ½ Σ r² there; +inf where the start gave no number.
        gradient: Jᵀr there, with 0 for a parameter that its bound holds back; NaN where J was not wanted.
        gradient_norm: Its Euclidean norm.
        n_evaluation: Residuals evaluated, those of the differences included.
        n_jacobian: Jacobians evaluated.
        n_iteration: Steps tried, those that were refused included.
        status: Why each start stopped, in row-major order of the batch; one entry where there is no batch.
        residual: r at the position.
        jacobian: J = ∂r/∂position there, columns of the held parameters too; without rows where it was not wanted.
    """

    position: Float[Tensor, "*batch n_dimension"]
    objective: Float[Tensor, "*batch"]
    gradient: Float[Tensor, "*batch n_dimension"]
    gradient_norm: Float[Tensor, "*batch"]
    n_evaluation: Int[Tensor, "*batch"]
    n_jacobian: Int[Tensor, "*batch"]
    n_iteration: Int[Tensor, "*batch"]
    status: tuple[LeastSquaresStatus, ...]
    residual: Float[Tensor, "*batch n_residual"]
    jacobian: Float[Tensor, "*batch n_kept n_dimension"]

    @property
    def normal_matrix(self) -> Float[Tensor, "*batch n_dimension n_dimension"]:
        """JᵀJ: times 1/σ² the information that residuals of standard deviation σ hold on the position.

        Raises:
            ValueError: if J was not kept.
        """
        if self.jacobian.shape[-2] != self.residual.shape[-1]:
            raise ValueError("The normal matrix needs the jacobian, which was not wanted. Set jacobian_at_end=True.")
        return self.jacobian.mT @ self.jacobian


class LeastSquaresProgress(NamedTuple):
    """Where the starts stand after an iteration; iteration 0 is the start.

    Attributes:
        iteration: Iterations done.
        n_evaluation: Residuals evaluated by each start so far.
        position: The best place of each start.
        objective: ½ Σ r² there.
        damping: What the next step would be damped with, relative to the squared column norms of J.
    """

    iteration: int
    n_evaluation: Int[Tensor, "*batch"]
    position: Float[Tensor, "*batch n_dimension"]
    objective: Float[Tensor, "*batch"]
    damping: Float[Tensor, "*batch"]
