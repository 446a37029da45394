"""What a script with NumPy and SciPy does: candidate by candidate, all modes by `scipy.linalg.eigh`, in complex."""

import numpy as np
import scipy.linalg
import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.bench.problem import LINES
from torchplate.model import PlateModel


class Peer:
    """The accelerances of the paper's plate; matrices that never change are made once.

    Args:
        model: its matrices, wires and places are taken from it; E, k, c and β are what its members give.
        frequency: lines [Hz].
    """

    def __init__(self, model: PlateModel, frequency: Float[Tensor, " n_frequency"] = LINES) -> None:
        unit = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
        system = model.system(unit)
        self.stiffness, self.mass = system.stiffness.numpy(), system.mass.numpy()
        self.wires = system.dashpot.numpy()
        self.attached = self.wires.T @ self.wires
        self.read, self.hit = (
            model.assembly.rows(model.mesh.deflection_at(model.mesh.places(points))).numpy()
            for points in (model.response or [], model.reference or [])
        )
        self.omega = 2 * np.pi * frequency.numpy()

    def modes(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ω² and mass-normalised shapes of one candidate."""
        return scipy.linalg.eigh(theta[0] * self.stiffness + theta[1] * self.attached, self.mass)

    def frf(self, theta: np.ndarray) -> np.ndarray:
        """Accelerances of one candidate [n_frequency, n_response, n_reference]."""
        value, shape = self.modes(theta)
        inverse = 1 / (value * (1 + 1j * theta[3]) - self.omega[:, None] ** 2)
        read, hit, tied = self.read @ shape, self.hit @ shape, self.wires @ shape
        left, right = np.vstack([read, tied]), np.vstack([hit, tied])
        whole = (left[None] * inverse[:, None, :]) @ right.T
        n, k = len(read), len(hit)
        gain = 1j * self.omega[:, None, None] * theta[2]
        correction = np.linalg.solve(np.eye(len(tied)) + gain * whole[:, n:, k:], gain * whole[:, n:, :k])
        return -(self.omega[:, None, None] ** 2) * (whole[:, :n, :k] - whole[:, :n, k:] @ correction)

    def generation(self, theta: Float[Tensor, "n_member 4"]) -> Complex[Tensor, "n_member n_f n_response n_reference"]:
        """All candidates, one after the other."""
        return torch.from_numpy(np.stack([self.frf(member) for member in theta.numpy()]))
