"""Whether a hidden effect shows: what is left of it once the parameters that the config searches are fitted.

The model without the effect is the Ritz plate itself in its lowest modes, so nothing of a mesh is in the answer. Fitted
by Gauss-Newton with finite differences: E, the wires' k and c, and log β where the config has one.
"""

from collections.abc import Callable

import numpy as np

from blind.effects import Truth
from blind.response import attach, observe, sat
from blind.ritz import modes

# Modes kept, some five times the band, and turns of the fit.
N_MODE = 90
N_TURN = 4
STEP = 1e-5


class Fitted:
    """FRFs over (log E, log k, log c, log β) as ratios to the truth's, in a basis of modes at the truth's own values.

    Args:
        truth: the plate without the effect in question.
        n_wire: how many of its springs and dashpots are the config's wires.
    """

    def __init__(self, truth: Truth, n_wire: int) -> None:
        self.truth = truth
        found = modes(truth.plate)
        self.n_parameter = 4 if truth.damping.beta else 3
        basis = found.shape[:, :N_MODE]
        self.response = found.deflection(sat(truth.plate, truth.chain, truth.test))[:, :N_MODE]
        self.reference = found.deflection(truth.test.reference)[:, :N_MODE]
        springs, dashpots = (np.array(terms) for terms in (truth.plate.springs, truth.plate.dashpots))
        rows = found.deflection(springs[:n_wire, :2].tolist())[:, :N_MODE]
        self.wires = rows.T @ (springs[:n_wire, 2:] * rows)
        self.plate = np.diag(found.eigenvalue[:N_MODE]) - self.wires
        self.at = found.deflection(dashpots[:, :2].tolist())[:, :N_MODE]
        self.viscous, self.is_wire = dashpots[:, 2], np.arange(len(dashpots)) < n_wire
        lossy = found.matrices.hysteretic
        self.lossy = None if lossy is None else basis.T @ lossy @ basis
        self.s = truth.test.laplace(truth.chain.rate)
        # What the modes beyond the basis add, at the values of the truth.
        self.rest = truth.frf() - self.kept(np.zeros(self.n_parameter))

    def __call__(self, log_ratio: np.ndarray) -> np.ndarray:
        return self.kept(log_ratio) + self.rest

    def kept(self, log_ratio: np.ndarray) -> np.ndarray:
        """FRFs of the kept modes."""
        young, stiffness, viscous, loss = np.exp(np.append(log_ratio, np.zeros(4 - len(log_ratio))))
        damping = self.truth.damping
        left, right = np.vstack([self.at, self.response]), np.vstack([self.at, self.reference])
        stiff = young * self.plate + stiffness * self.wires
        s = self.s[:, None]
        if self.lossy is None:
            value, vector = np.linalg.eigh(stiff)
            left, right = left @ vector, right @ vector
            value = value * (1 + 1j * damping.beta * loss + s * damping.b)
        else:
            value, vector = np.linalg.eig(stiff * (1 + 1j * damping.beta * loss) + 1j * young * self.lossy)
            left, right = left @ vector, np.linalg.solve(vector, right.T.astype(complex)).T
        inverse = 1 / (value + 1j * damping.eta + s * damping.a + s**2)
        pairs = (left[:, None] * right[None]).reshape(-1, inverse.shape[1])
        alpha = (inverse @ pairs.T).reshape(len(s), len(left), len(right))
        dynamic = s * self.viscous * np.where(self.is_wire, viscous, 1.0)
        return observe(attach(alpha, dynamic), self.truth.chain, self.truth.test)


def remains(frf: np.ndarray, model: Callable[[np.ndarray], np.ndarray], n_parameter: int, needed: float = 0.0) -> float:
    """Root mean square over FRFs of ‖frf − model‖ / ‖frf‖ at the best fit found, the start included [-].

    Args:
        frf: the truth.
        model: FRFs over logarithms of ratios.
        n_parameter: how many of these there are.
        needed: the fit ends as soon as less than that is left.
    """
    weight = 1 / np.linalg.norm(frf, axis=0) / np.sqrt(frf[0].size)

    def residual(log_ratio: np.ndarray) -> np.ndarray:
        flat = ((model(log_ratio) - frf) * weight).ravel()
        return np.concatenate([flat.real, flat.imag])

    at = np.zeros(n_parameter)
    now = residual(at)
    for _ in range(N_TURN):
        if np.linalg.norm(now) < needed:
            break
        slope = np.stack([(residual(at + STEP * unit) - now) / STEP for unit in np.eye(n_parameter)], axis=1)
        linear = np.linalg.lstsq(slope, -now, rcond=1e-10)[0]
        move = linear * min(1.0, 0.3 / max(np.abs(linear).max(), 1e-12))
        tried = {part: residual(at + part * move) for part in (1.0, 0.3)}
        part, best = min(tried.items(), key=lambda item: float(np.linalg.norm(item[1])))
        gained = float(np.linalg.norm(now) - np.linalg.norm(best))
        if gained <= 0:
            break
        at, now = at + part * move, best
        if gained < 0.01 * float(np.linalg.norm(now)):
            break
    return float(np.linalg.norm(now))


def detectable(truth: Truth, without: Truth, n_wire: int, needed: float = 0.0) -> float:
    """What remains of the difference between two truths, over the FRFs' norm [-]; see `remains`."""
    frf = truth.frf()
    fitted = Fitted(without, n_wire)
    return remains(frf, fitted, fitted.n_parameter, needed)
