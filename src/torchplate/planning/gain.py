"""What a test is expected to say of the names, from what each hypothesis predicts of it.

Over noise and nuisances hypothesis i predicts numbers y ~ N(m_i, I + B_i B_iᵀ), B_i the columns of what it leaves open.
That is its likelihood after its own parameters were refitted, with their posterior as prior: so two hypotheses are
apart by no more than what neither can follow. All m_i and B_i lie in a subspace of few dimensions, and outside it all
densities are the same. There y is drawn from each hypothesis in turn, and its posterior follows,

    p(i | y) ∝ p_i N(y; m_i, I + B_i B_iᵀ).

What a test is ranked by is the mean over the draws of the probability of the right name; that of log₂ p(i | y) / p_i
is the information that it brings, in bits.

Sources: Lindley, On a measure of the information provided by an experiment, Ann. Math. Statist. 27 (1956) 986; Box and
Hill, Discrimination among mechanistic models, Technometrics 9 (1967) 57, for designs that part models; Kolchinsky and
Tracey, Entropy 19 (2017) 361, for the bound by pairwise distances that the tests hold it to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.planning.forthcoming import Predicted

# Directions that hold less than this part of the greatest variance are rounding [-].
ROUNDING = 1e-12
# Draws from each hypothesis: an expected probability of 0.95 is then good to 0.01.
N_DRAW = 400


@dataclass(frozen=True)
class Gain:
    """What a test is expected to bring.

    Attributes:
        probability: of the right name after it, on the mean [-].
        bits: of information on the name.
        said: true name → name → its posterior probability, on the mean [-].
        narrowed: "label.parameter" → its standard deviation after the test over that before [-], under the most
            probable hypothesis.
    """

    probability: float
    bits: float
    said: Mapping[str, Mapping[str, float]]
    narrowed: Mapping[str, float]


def expected_gain(names: Sequence[str], prior: Sequence[float], predicted: Sequence[Predicted], seed: int = 0) -> Gain:
    """What a test is expected to bring, but for the parameters.

    Args:
        names: of each hypothesis.
        prior: their probabilities, as they are before.
        predicted: what each says of the test.
        seed: of the draws.
    """
    mean, root = _in_subspace(predicted)
    p = torch.tensor(prior, dtype=torch.float64)
    p = p / p.sum()
    unique = list(dict.fromkeys(names))
    of_name = torch.tensor([[float(name == one) for one in names] for name in unique], dtype=torch.float64)
    before = of_name @ p
    generator = torch.Generator().manual_seed(seed)
    posterior = []
    factors = [_lower(part) for part in root]
    for one, part in zip(mean, root, strict=True):
        noise = torch.randn(N_DRAW, mean.shape[-1], generator=generator, dtype=torch.float64)
        own = torch.randn(N_DRAW, part.shape[-1], generator=generator, dtype=torch.float64)
        drawn = one + noise + own @ part.mT
        density = torch.stack([_log_density(drawn, *pair) for pair in zip(mean, factors, strict=True)], dim=-1)
        posterior.append((p.log() + density).softmax(-1) @ of_name.mT)
    said = torch.stack(posterior)  # [true hypothesis, draw, name]
    index = [unique.index(name) for name in names]
    right = torch.stack([one[:, k] for one, k in zip(said, index, strict=True)])
    information = (right.clamp(min=1e-300) / before[index][:, None]).log2().mean(-1)
    by_name = {
        name: {other: float((p * of_name[k] * said.mean(1)[:, j]).sum() / before[k]) for j, other in enumerate(unique)}
        for k, name in enumerate(unique)
    }
    return Gain(float(p @ right.mean(-1)), float(p @ information), by_name, {})


def narrowed(names: Sequence[str], axes: Float[Tensor, "n n"], predicted: Predicted) -> dict[str, float]:
    """Standard deviations after the test over those before, of one hypothesis.

    Args:
        names: its parameters.
        axes: principal axes of their posterior, as columns.
        predicted: what it says of the test.
    """
    columns = predicted.columns
    precision = torch.eye(columns.shape[-1]).to(columns) + columns.mT @ columns
    n = predicted.n_parameter
    after = torch.cholesky_inverse(torch.linalg.cholesky(precision))[:n, :n]
    ratio = ((axes @ after) * axes).sum(-1) / axes.square().sum(-1)
    return dict(zip(names, ratio.clamp(0.0, 1.0).sqrt().tolist(), strict=True))


def _in_subspace(predicted: Sequence[Predicted]) -> tuple[Float[Tensor, "n_hypothesis d"], list[Tensor]]:
    """Means and columns in coordinates of the subspace that they span."""
    mean = torch.stack([one.mean for one in predicted], dim=-1)
    every = torch.cat([mean, *(one.columns for one in predicted)], dim=-1)
    size = every.norm(dim=0).clamp(min=1e-300)
    # Columns of one length, so that what shows little keeps its digits.
    scaled = every / size
    value, vector = torch.linalg.eigh(scaled.mT @ scaled)
    kept = value > ROUNDING * value[-1]
    inside = (value[kept].sqrt()[:, None] * vector[:, kept].mT) * size
    parts = inside.split([mean.shape[-1], *(one.columns.shape[-1] for one in predicted)], dim=-1)
    return parts[0].mT, list(parts[1:])


def _lower(root: Float[Tensor, "d k"]) -> Float[Tensor, "d d"]:
    return torch.linalg.cholesky(torch.eye(len(root)).to(root) + root @ root.mT)


def _log_density(
    drawn: Float[Tensor, "n_draw d"], mean: Float[Tensor, " d"], lower: Float[Tensor, "d d"]
) -> Float[Tensor, " n_draw"]:
    """Up to a constant that all hypotheses share."""
    off = torch.linalg.solve_triangular(lower, (drawn - mean).mT, upper=False)
    return -0.5 * off.square().sum(0) - lower.diagonal().log().sum()
