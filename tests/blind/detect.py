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


# What is asked of −2 log marginal likelihood before an effect is to be named. With no prior knowledge of which of some
# thirty effects is missing, the true one must make up for 1/30: 2 ln 30 = 6.8. Each of its parameters costs the usual
# Occam factor, 2 ln of its prior range over its posterior's: some ten posterior standard deviations, times √(2π).
N_HYPOTHESIS = 30
OCCAM = 2 * float(np.log(10 / np.sqrt(2 * np.pi)))
# One-sided, 5 %: the fall that is seen scatters about λ by 2 √λ.
Z95 = 1.645
# Of what lies beyond the catalogue: nothing else speaks for it than what is left over all lines, and that only beyond
# what the level of the noise is known to, 10 % in power.
NOISE_KNOWN = 0.1


def needed(n_parameter: int) -> float:
    """The fall of −2 log likelihood at which an effect of so many parameters is as probable as none."""
    return 2 * float(np.log(N_HYPOTHESIS)) + OCCAM * n_parameter


def seen(fall: float, n_parameter: int) -> str:
    """Whether an effect whose expected fall is λ is to be named.

    Returns:
        "yes" where 19 of 20 tests see more than is needed, "no" where 19 of 20 see less, else "either".
    """
    return _within(fall, needed(n_parameter), 2 * Z95 * float(np.sqrt(max(fall, 0.0))))


def seen_beyond(fall: float, n_data: int) -> str:
    """The same of what no effect describes, from n real numbers: χ² of n scatters by √(2 n)."""
    return _within(fall, NOISE_KNOWN * n_data, Z95 * float(np.sqrt(2 * n_data + 4 * max(fall, 0.0))))


def _within(fall: float, bound: float, scatter: float) -> str:
    return "yes" if fall - scatter > bound else "no" if fall + scatter < bound else "either"
