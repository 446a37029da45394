"""How large and how smooth a field may be: cross-validation over the FRFs.

About one place the residuals are r + J_u δ + J_v v, v the values of the field, δ a step of the other parameters. With a
precision Λ = P / s² of v and the noise of r one, the values are

    x = (δ, v) = −(JᵀJ + diag(0, Λ))⁻¹ Jᵀr.

P is one of a few: all values alike (`rough`), values that go together over some spacings of the nodes (`smooth`, a
Gaussian covariance), or a few values only (`sparse`, weights 1 / (v² + ε²) of the values before: reweighted least
squares). In the first two, what a stiffness has along x, along y and in twist has half of its variance in common. Form
and s are those at which the FRFs that were left out, a fold at a time, are predicted best.

Sources: Golub, Heath and Wahba, Technometrics 21 (1979) 215, on choosing a ridge; Candès, Wakin and Boyd, Enhancing
sparsity by reweighted l1 minimization, J. Fourier Analysis and Applications 14 (2008) 877, on the weights.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.settings.field import FieldInference


class Products(NamedTuple):
    """What least squares need of residuals and their Jacobian, fold by fold; the field counted from none.

    Attributes:
        gram: JᵀJ.
        right: Jᵀr.
        square: rᵀr.
        told: JᵀJ and Jᵀr of what is known beforehand, which no fold leaves out.
        n: real numbers in all folds.
        n_value: of the last columns, those of the field.
    """

    gram: Float[Tensor, "n_fold n n"]
    right: Float[Tensor, "n_fold n"]
    square: Float[Tensor, " n_fold"]
    told: tuple[Float[Tensor, "n n"], Float[Tensor, " n"]]
    n: int
    n_value: int


class Chosen(NamedTuple):
    """A prior of the field, and what it makes of the data.

    Attributes:
        form: rough, smooth or sparse.
        precision: Λ.
        std: s: of a value before anything was seen, on the mean over the nodes.
        error: mean square of what is left of FRFs that were left out.
    """

    form: str
    precision: Float[Tensor, "n_value n_value"]
    std: float
    error: float


def forms(
    grid: Grid, values: Float[Tensor, " n_value"], settings: FieldInference
) -> dict[str, Float[Tensor, "n_value n_value"]]:
    """P of each form, of a standard deviation of one on the mean over the nodes.

    Args:
        grid: of the nodes.
        values: those before; where they are none no field is sparse.
        settings: of the inference.
    """
    place = grid.place * torch.tensor([grid.n_x - 1, grid.n_y - 1], dtype=torch.float64)
    far = (place[:, None] - place).square().sum(-1)
    one = torch.eye(len(place), dtype=torch.float64)
    near = torch.exp(-0.5 * far / settings.spacing**2) + settings.alone * one
    n_part = len(grid.parts(values))
    together = settings.together + (1 - settings.together) * torch.eye(n_part, dtype=torch.float64)
    covariances = {"rough": one, "smooth": near / float(near.diagonal().mean())}
    found = {form: torch.linalg.inv(torch.kron(together, within)) for form, within in covariances.items()}
    if bool((values != 0).any()):
        size = values.square() + (settings.floor * float(values.abs().max())) ** 2
        found["sparse"] = torch.diag(size.mean() / size)
    return found


def cross_validated(
    products: Products, shapes: dict[str, Tensor], settings: FieldInference, nonnegative: bool = False
) -> Chosen:
    """The form and the strength that predict best what was left out.

    Args:
        products: of the data.
        shapes: P of each form.
        settings: of the inference.
        nonnegative: a value that would be negative is none.
    """
    whole, right = products.gram.sum(0) + products.told[0], products.right.sum(0) + products.told[1]
    k = len(right) - products.n_value
    typical = float(whole.diagonal()[k:].mean().clamp(min=1e-300))
    low, high, n_decade = settings.strengths
    # A value alone is known to 1/√(JᵀJ).
    sizes = 10 ** torch.arange(low, high + 1e-9, 1 / n_decade, dtype=torch.float64) / typical**0.5
    best: Chosen | None = None
    for form, shape in shapes.items():
        for std in sizes.tolist():
            more = torch.zeros_like(whole)
            more[k:, k:] = shape / std**2
            _, held_now = solved(whole + more, right, settings, products.n_value if nonnegative else 0)
            more = more + torch.diag(held_now)
            error = _error(products, whole, right, more)
            if best is None or error < best.error:
                best = Chosen(form, shape / std**2, std, error)
    assert best is not None
    return best


def _error(products: Products, whole: Tensor, right: Tensor, more: Tensor) -> float:
    """Mean square of what is left of each fold, predicted from the others."""
    matrices, sides = whole + more - products.gram, right - products.right
    x = _solved(matrices, sides)
    left = products.square + 2 * (products.right * x).sum(-1) + ((products.gram @ x[..., None])[..., 0] * x).sum(-1)
    return float(left.sum()) / products.n


def solved(
    matrix: Float[Tensor, "n n"], right: Float[Tensor, " n"], settings: FieldInference, n_nonnegative: int = 0
) -> tuple[Float[Tensor, " n"], Float[Tensor, " n"]]:
    """−matrix⁻¹ right, the last few not negative, and what had to be added to the diagonal for that."""
    held = torch.zeros_like(right)
    x = _solved(matrix, right)
    last = slice(len(right) - n_nonnegative, None)
    for _ in range(settings.n_holding if n_nonnegative else 0):
        negative = x[last] < -x[last].abs().max() / settings.holding
        if not bool(negative.any()):
            break
        held[last] += torch.where(negative, settings.holding * matrix.diagonal()[last].mean(), 0.0)
        x = _solved(matrix + torch.diag(held), right)
    return x, held


def _solved(matrix: Float[Tensor, "*batch n n"], right: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
    """−matrix⁻¹ right, by columns of equal norm; directions that nothing knows stay where they are."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    # Where one fold alone sees a direction, the others leave rounding of it, which may be none or negative.
    most = diagonal.flatten(0, -2).amax(0) if diagonal.ndim > 1 else diagonal
    seen = diagonal > 1e-13 * most.clamp(min=1e-300)
    norm = torch.where(seen, diagonal, 1.0).sqrt()
    scaled = matrix * (seen[..., :, None] & seen[..., None, :]) / norm[..., :, None] / norm[..., None, :]
    scaled = scaled + torch.diag_embed((~seen).to(matrix)) + 1e-10 * torch.eye(matrix.shape[-1]).to(matrix)
    return -torch.linalg.solve(scaled, torch.where(seen, right, 0.0) / norm) / norm
