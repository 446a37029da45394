"""How far a hidden effect shows above noise and nuisances: the chi-square that the best model without it leaves.

λ = min over θ, ν of ‖(H_with − H_without(θ, ν)) / σ‖² + Σ ((ν − ν_true) / S)²

θ are the parameters that the config searches, without a prior; ν the nuisances with their standard deviations S. To
first order that is dᵀ P d with the covariance N + J S² Jᵀ and all that θ explains projected out; as modes move by more
than their width under the nuisances, the minimum is found by Gauss-Newton instead, with the same J. It is the truth's
own information: no model of torchplate is in it. J: derivatives of mass and stiffness by finite differences of the
truth's matrices, in a basis of its lowest modes, then exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from blind.effects import Truth
from blind.nuisances import Imperfect
from blind.response import attach, observe, sat
from blind.ritz import LIGHT, N_WANDER, WANDER, Modes, RitzPlate, matrices_of, modes

# Modes kept, three times the band and more; turns of the fit; lines × FRFs that are looked at.
N_MODE = 70
N_TURN = 8
N_DATA = 4000
# Nuisances are followed so many standard deviations far.
FARTHEST = 6.0
# A λ above this shows, however much the fit would still gain.
EVIDENT = 100.0
STEP = 1e-4
# Natural frequencies of a model that a diagnosis can afford are right to so much, each for itself [-].
MESH = 1e-4
# Modes nearer than this are followed as a pair [-].
NEAR = 0.02
# How well natural frequencies are matched before FRFs are: a tenth of the least width of a peak [-].
MATCHED = 1e-4


@dataclass(frozen=True)
class Prior:
    """One parameter of the plate: its changes of K and M in the basis, and its standard deviation (inf: searched)."""

    stiffness: np.ndarray
    mass: np.ndarray | None
    std: float


def structural(truth: Truth, found: Modes, std: Imperfect, stated: frozenset[str]) -> list[Prior]:
    """Nuisances of the plate itself.

    Args:
        truth: the plate without the effect in question.
        found: its modes.
        std: how large they are.
        stated: numbers that the config gives with a std.
    """
    plate, basis = truth.plate, found.shape[:, :N_MODE]
    base = found.matrices

    def slope(changed: RitzPlate, step: float) -> tuple[np.ndarray, np.ndarray]:
        other = matrices_of(changed)
        return tuple(
            basis.T @ ((one - zero) / step) @ basis
            for one, zero in ((other.stiffness, base.stiffness), (other.mass, base.mass))
        )  # type: ignore[return-value]

    priors = []
    wander = std.wander / np.sqrt(N_WANDER)
    for name in ("thickness_wander", "modulus_wander"):
        for k in range(len(WANDER)):
            now = [*getattr(plate, name), *[0.0] * len(WANDER)][: len(WANDER)]
            now[k] += STEP
            priors.append(Prior(*slope(replace(plate, **{name: tuple(now)}), STEP), wander))
    changes = {
        "grain": (replace(plate, young_ratio=plate.young_ratio * (1 + STEP)), std.grain),
        "length_x": (replace(plate, aspect_ratio=plate.aspect_ratio * (1 + STEP)), std.side * _both(plate)),
        "thickness": (replace(plate, thickness=plate.thickness * (1 + STEP)), std.thickness),
        "density": (replace(plate, density=plate.density * (1 + STEP)), std.density),
    }
    priors += [
        Prior(*slope(changed, STEP), spread)
        for name, (changed, spread) in changes.items()
        if name == "grain" or name in stated
    ]
    light = [mass for mass in plate.masses if mass[2] <= LIGHT * plate.mass]
    for x, y, _ in light:
        row = found.deflection([(x, y)])[0, :N_MODE]
        priors.append(Prior(np.zeros((len(row),) * 2), np.outer(row, row), std.sensor_std))
    return priors


def _both(plate: RitzPlate) -> float:
    """Relative standard deviation of Ly/Lx for one of each side."""
    return float(np.hypot(1 / plate.sides[0], 1 / plate.sides[1]))


class Marginal:
    """The plate without an effect, over what is searched and what is a nuisance.

    Args:
        truth: without the effect.
        n_wire: how many of its springs and dashpots are the config's wires.
        sigma: of the noise [n_line, n_response, n_reference].
        std: of the nuisances.
        stated: numbers that the config gives with a std.
    """

    def __init__(self, truth: Truth, n_wire: int, sigma: np.ndarray, std: Imperfect, stated: frozenset[str]) -> None:
        self.truth, self.std = truth, std
        found = modes(truth.plate)
        n = min(N_MODE, len(found.eigenvalue))
        stride = max(1, round(sigma.size / N_DATA))
        self.lines = np.arange(stride // 2, len(sigma), stride)
        # Fewer lines, each as sure as those it stands for together.
        self.weight = np.sqrt(len(sigma) / len(self.lines)) / sigma[self.lines]
        # Labels and signs part from the truth's own: the model knows of none.
        self.chain = replace(truth.chain, drift=None, calibration=None)
        self.test = replace(truth.test, frequency=truth.test.frequency[self.lines])
        self.s = self.test.laplace(truth.chain.rate)
        places, ends = sat(truth.plate, truth.chain, self.test), self.test.reference
        springs, dashpots = (np.array(terms).reshape(-1, 3) for terms in (truth.plate.springs, truth.plate.dashpots))
        rows = found.deflection(springs[:n_wire, :2].tolist())[:, :n]
        wires = rows.T @ (springs[:n_wire, 2:] * rows)
        self.whole = np.diag(found.eigenvalue[:n])
        self.plate = self.whole - wires
        self.at = found.deflection(dashpots[:, :2].tolist())[:, :n]
        self.viscous, self.is_wire = dashpots[:, 2], np.arange(len(dashpots)) < n_wire
        lossy = found.matrices.hysteretic
        self.lossy = np.zeros((n, n)) if lossy is None else found.shape[:, :n].T @ lossy @ found.shape[:, :n]
        omega = np.sqrt(found.eigenvalue[:n].clip(0.0))
        d = truth.damping
        own = d.beta * omega**2 + d.eta + d.a * omega + d.b * omega**3 + np.diag(self.lossy)
        self.own = own + omega * (self.viscous @ self.at**2)
        factor = np.ones(n)
        kept = min(n, len(d.scatter))
        factor[:kept] = d.scatter[:kept]
        self.scatter = np.diag((factor - 1) * self.own)
        top = 2 * np.pi * 1.1 * truth.test.frequency[-1]
        self.seen = np.flatnonzero(omega < top)
        self.near = [(i, j) for i in self.seen for j in self.seen if i < j and omega[j] < (1 + NEAR) * omega[i]]
        self.priors = [Prior(self.plate, None, np.inf), Prior(wires, None, np.inf)]
        self.priors += structural(truth, found, std, stated)
        self.n_damping = 2 if d.beta else 1
        self.sides = np.array(truth.plate.sides)
        self.response, self.reference = (self._with_slopes(found, at, n) for at in (places, ends))
        # As in `detect.Fitted`: what the modes beyond the basis add, at the values of the truth.
        motion = self._read(truth)
        self.rest = motion - self._observed(self._solve(np.zeros(len(self.priors) + self.n_damping))[0])

    def _read(self, truth: Truth) -> np.ndarray:
        """The truth on the lines that are looked at, without drift and gains of its channels."""
        plain = replace(truth, chain=self.chain, test=self.test)
        return plain.frf()

    def _with_slopes(self, found: Modes, places: Sequence[Sequence[float]], n: int) -> np.ndarray:
        """Deflections at places, then their slopes along x and along y [3 n_place, n] [1/m]."""
        at, step = np.array(places, float).reshape(-1, 2), 1e-5
        rows = [found.deflection(at.tolist())[:, :n]]
        for along in (0, 1):
            # Within the plate on both sides.
            middle = at.copy()
            middle[:, along] = middle[:, along].clip(step, 1 - step)
            ends = []
            for sign in (-1, 1):
                moved = middle.copy()
                moved[:, along] += sign * step
                ends.append(found.deflection(moved.tolist())[:, :n])
            rows.append((ends[1] - ends[0]) / (2 * step * self.sides[along]))
        return np.concatenate(rows)

    def _solve(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Closed-loop receptances: [R, K], [R + slopes, basis], [basis, K + slopes], and κ."""
        n = len(self.plate)
        c, beta = np.exp(at[len(self.priors)]), np.exp(at[-1]) if self.n_damping == 2 else 1.0
        d = self.truth.damping
        stiff = self.whole + sum(v * p.stiffness for v, p in zip(at, self.priors, strict=False))
        # In the basis the truth's modes are orthonormal.
        mass = np.eye(n) + sum(v * p.mass for v, p in zip(at, self.priors, strict=False) if p.mass is not None)
        # sbK with the truth's b only where there is one: κ varies with s.
        s = self.s
        whole = stiff * (1 + 1j * d.beta * beta) + 1j * (self.lossy + self.scatter)
        value, vector = scipy.linalg.eig(whole, mass)
        back = np.linalg.inv(mass @ vector)
        left = np.vstack([self.at, self.response]) @ vector
        right = back @ np.vstack([self.at, self.reference]).T
        inverse = 1 / (value * (1 + s[:, None] * d.b) + (1j * d.eta + s * d.a + s**2)[:, None])
        n_at, n_reference = len(self.at), self.weight.shape[2]
        dynamic = s[:, None] * self.viscous * np.where(self.is_wire, c, 1.0)
        to = np.concatenate([right[:, :n_at], back, right[:, n_at:]], axis=1)
        first = attach((left[None] * inverse[:, None, :]) @ to, dynamic)
        frm = np.concatenate([left[:n_at], vector])
        second = attach((frm[None] * inverse[:, None, :]) @ right[:, : n_at + n_reference], dynamic)
        return first[:, :, n:], first[:, :, :n], second, 1 + 1j * d.beta * beta + s * d.b

    def _observed(self, motion: np.ndarray) -> np.ndarray:
        n_response, n_reference = self.weight.shape[1:]
        return observe(motion[:, :n_response, :n_reference], self.chain, self.test)

    def _labelled(self, motion: np.ndarray) -> np.ndarray:
        """A change of the receptance as it is read [n_change, n_line, R, K]."""
        return np.stack([observe(one, self.chain, self.test) for one in motion])

    def step(self, at: np.ndarray, aim: np.ndarray) -> tuple[float, np.ndarray]:
        """χ² at a point with all channel nuisances fitted, and where Gauss-Newton would go from there.

        Args:
            at: of what is searched and of the plate's nuisances.
            aim: FRFs of the truth with the effect, without drift and gains.
        """
        motion, to, frm, kappa = self._solve(at)
        n_response, n_reference = self.weight.shape[1:]
        to_own, frm_own = to[:, :n_response], frm[:, :, :n_reference]
        changes = []
        for prior in self.priors:
            change = -kappa[:, None, None] * (to_own @ prior.stiffness @ frm_own)
            if prior.mass is not None:
                d, s = self.truth.damping, self.s
                mu = 1j * d.eta + s * d.a + s**2
                change = change - mu[:, None, None] * (to_own @ prior.mass @ frm_own)
            changes.append(change)
        wires = np.where(self.is_wire, self.viscous * np.exp(at[len(self.priors)]), 0.0)
        wired = self.at.T @ (wires[:, None] * self.at)
        changes.append(-self.s[:, None, None] * (to_own @ wired @ frm_own))
        stiff = self.whole + sum(v * p.stiffness for v, p in zip(at, self.priors, strict=False))
        d = self.truth.damping
        if self.n_damping == 2:
            changes.append(-1j * d.beta * np.exp(at[-1]) * (to_own @ stiff @ frm_own))
        std = [prior.std for prior in self.priors] + [np.inf] * self.n_damping
        centre = [*at]
        if self.std.damping:
            for mode in self.seen:
                changes.append(-1j * self.own[mode] * to_own[:, :, mode, None] * frm_own[:, mode, None, :])
            std += [self.std.damping] * len(self.seen)
            centre += [0.0] * len(self.seen)
            # A mesh leaves each natural frequency an error of its own.
            changes += [
                -2
                * self.whole[mode, mode]
                * kappa[:, None, None]
                * to_own[:, :, mode, None]
                * frm_own[:, mode, None, :]
                for mode in self.seen
            ]
            std += [MESH] * len(self.seen)
            centre += [0.0] * len(self.seen)
            # Two modes of nearly one frequency have no shapes of their own: what scatters is their common matrix.
            for i, j in self.near:
                off = to_own[:, :, i, None] * frm_own[:, j, None, :] + to_own[:, :, j, None] * frm_own[:, i, None, :]
                changes.append(-1j * np.sqrt(self.own[i] * self.own[j]) * off)
            std += [self.std.damping / np.sqrt(2)] * len(self.near)
            centre += [0.0] * len(self.near)
        whole = self._labelled(np.stack(changes)) * self.weight
        now = self._observed(motion) + self.rest
        residual = (aim - now) * self.weight
        # (1 + δ)² K in place of K.
        shift = -2 * (to_own @ stiff @ frm_own) * kappa[:, None, None]
        solved, chi2 = self._normal(whole, residual, np.array(std), np.array(centre), motion, shift, now)
        return chi2, solved[: len(at)]

    def _normal(
        self,
        whole: np.ndarray,
        residual: np.ndarray,
        std: np.ndarray,
        centre: np.ndarray,
        motion: np.ndarray,
        shift: np.ndarray,
        now: np.ndarray,
    ) -> tuple[np.ndarray, float]:
        """Least squares over the plate's parameters and every channel's own, by its normal matrix.

        Returns:
            The move of the plate's parameters, and χ² where only the linear ones (channels, damping) have moved.
        """
        n_response, n_reference = self.weight.shape[1:]
        first, second = slice(0, n_response), slice(0, n_reference)
        by_reference = [motion[:, first, (1 + k) * n_reference : (2 + k) * n_reference] for k in (0, 1)]
        by_response = [motion[:, (1 + k) * n_response : (2 + k) * n_response, second] for k in (0, 1)]
        gain = now * self.weight
        a, a_std = self._columns([(by_reference, self.std.position), ([shift], self.std.drift)], gain)
        b, b_std = self._columns([(by_response, self.std.position)], gain)
        n, n_a, n_b = len(whole), len(a), len(b)
        size = n + n_a * n_reference + n_b * n_response
        normal, right = np.zeros((size, size)), np.zeros(size)
        flat = whole.reshape(n, -1)
        normal[:n, :n] = (flat.conj() @ flat.T).real
        right[:n] = (flat.conj() @ residual.ravel()).real
        index_a = n + np.arange(n_a * n_reference).reshape(n_a, n_reference)
        index_b = n + n_a * n_reference + np.arange(n_b * n_response).reshape(n_b, n_response)

        def fill(rows: np.ndarray, columns: np.ndarray, values: np.ndarray) -> None:
            normal[np.ix_(rows.ravel(), columns.ravel())] = values
            normal[np.ix_(columns.ravel(), rows.ravel())] = values.T

        for k in range(n_reference):
            local = a[:, :, :, k].reshape(n_a, -1)
            part = whole[:, :, :, k].reshape(n, -1)
            fill(index_a[:, k], index_a[:, k], (local.conj() @ local.T).real)
            fill(np.arange(n), index_a[:, k], (part.conj() @ local.T).real)
            right[index_a[:, k]] = (local.conj() @ residual[:, :, k].ravel()).real
            for j in range(n_response):
                cross = (a[:, :, j, k].conj() @ b[:, :, j, k].T).real
                fill(index_a[:, k], index_b[:, j], cross)
        for j in range(n_response):
            local = b[:, :, j, :].reshape(n_b, -1)
            part = whole[:, :, j, :].reshape(n, -1)
            fill(index_b[:, j], index_b[:, j], (local.conj() @ local.T).real)
            fill(np.arange(n), index_b[:, j], (part.conj() @ local.T).real)
            right[index_b[:, j]] = (local.conj() @ residual[:, j, :].ravel()).real
        stds = np.concatenate([std, np.repeat(a_std, n_reference), np.repeat(b_std, n_response)])
        penalty = np.where(stds > 0, 1 / np.maximum(stds, 1e-12) ** 2, 1e24)
        start = np.concatenate([centre, np.zeros(size - n)])
        prior = float((penalty * start**2).sum())
        whole_normal = normal + np.diag(penalty)
        gradient = right - penalty * start
        plate = len(self.priors) + self.n_damping
        linear = np.arange(plate, size)
        total = float((np.abs(residual) ** 2).sum()) + prior
        moved = _spd_solve(whole_normal[np.ix_(linear, linear)], gradient[linear])
        here = total - float(gradient[linear] @ moved)
        return _spd_solve(whole_normal, gradient), here

    def _columns(self, ends: list[tuple[list[np.ndarray], float]], gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighed columns of channel nuisances, as read, the gain last, and their standard deviations."""
        columns = [part for parts, _ in ends for part in parts]
        stds = [std for parts, std in ends for _ in parts]
        read = self._labelled(np.stack(columns)) * self.weight
        return np.concatenate([read, gain[None]]), np.array([*stds, self.std.calibration])

    def left(self, effect: Truth | np.ndarray) -> float:
        """λ of what another truth, or its FRFs, have beyond this one."""
        at = np.zeros(len(self.priors) + self.n_damping)
        if isinstance(effect, np.ndarray):
            # Beside the truth's own drift and gains, which are no part of the difference.
            return self._descend(at, self._observed(self._solve(at)[0]) + self.rest + self._beyond(effect))
        aim = replace(effect, chain=replace(effect.chain, drift=None, calibration=None), test=self.test).frf()
        if effect.plate == self.truth.plate:
            return self._descend(at, aim)
        # Peaks that do not overlap have no slope towards each other: natural frequencies come first.
        start = np.concatenate([self._matched(modes(effect.plate).eigenvalue[self.seen]), at[len(self.priors) :]])
        found = self._descend(start, aim)
        return min(found, self._descend(at, aim)) if found > EVIDENT else found

    def _matched(self, aim: np.ndarray) -> np.ndarray:
        """Parameters of the plate whose natural frequencies are those of the other, as far as the priors let them."""
        at = np.zeros(len(self.priors))
        std = np.array([min(prior.std, 1.0) for prior in self.priors])
        n = len(aim)
        for _ in range(N_TURN):
            stiff = self.whole + sum(v * p.stiffness for v, p in zip(at, self.priors, strict=True))
            mass = np.eye(len(stiff)) + sum(
                v * p.mass for v, p in zip(at, self.priors, strict=True) if p.mass is not None
            )
            value, vector = scipy.linalg.eigh(stiff, mass)
            shape = vector[:, :n]
            slopes = []
            for prior in self.priors:
                slope = np.einsum("im,ij,jm->m", shape, prior.stiffness, shape, optimize=True)
                if prior.mass is not None:
                    slope -= value[:n] * np.einsum("im,ij,jm->m", shape, prior.mass, shape, optimize=True)
                slopes.append(slope / (2 * value[:n]))
            slope = np.stack(slopes, axis=1) * std / MATCHED
            residual = 0.5 * np.log(aim / value[:n].clip(1e-9)) / MATCHED
            whole, right = np.vstack([slope, np.eye(len(std))]), np.concatenate([residual, -at / std])
            move = std * np.linalg.lstsq(whole, right, rcond=None)[0]
            at = at + move * min(1.0, 0.3 / max(float(np.abs(move[:2]).max()), 1e-12))
            at[:2] = at[:2].clip(-0.9, 3.0)
            at = at.clip(-FARTHEST * std, FARTHEST * std)
        return at

    def _beyond(self, frf: np.ndarray) -> np.ndarray:
        return (frf - self.truth.frf())[self.lines]

    def _descend(self, at: np.ndarray, aim: np.ndarray) -> float:
        best, move = self.step(at, aim)
        limit = np.array([FARTHEST * min(p.std, 0.5) for p in self.priors] + [5.0] * self.n_damping)
        for _ in range(N_TURN):
            part, gained = min(1.0, 0.3 / max(float(np.abs(move[[0, -1]]).max()), 1e-12)), False
            for _ in range(3):
                next_at = np.clip(at + part * move, -limit, limit)
                found, next_move = self.step(next_at, aim)
                if np.isfinite(found) and found < best:
                    gained = True
                    break
                part *= 0.3
            if not gained:
                break
            at, move = next_at, next_move
            stop = best - found < (0.1 if found > 100 * EVIDENT else 0.01) * found + 0.01
            best = found
            if stop:
                break
        return max(best, 0.0)


def _spd_solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """A symmetric system, scaled to a unit diagonal; what nothing decides stays."""
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale * scale[:, None]
    scaled[np.diag_indices(len(scaled))] += 1e-10
    return scale * np.linalg.solve(scaled, scale * right)
