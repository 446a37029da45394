"""What a sensor would read of a Ritz plate: FRFs with all damping, the window and the sensor chain.

Z(s) = g(s) K (1 + iβ + s b) + M (iη + s a + s²) + iH + s C, with s = iω + rate. Undamped modes make all but C and H
diagonal; H is taken along by complex modes, C and whatever else sits at points by the Woodbury identity at every line.

Source: the seed paper, Eq. 17–18; Ewins, Modal Testing (2000); Fladung and Rost, MSSP 11 (1997) 23, for the window.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from blind.ritz import LIGHT, N_SPAN, Modes, RitzPlate, modes

DERIVATIVE = {"receptance": 0, "mobility": 1, "accelerance": 2}
# Modes kept beside a damping patch, some four times the band, and those whose coupling by it is followed.
N_LOW, N_COUPLED = 60, 35
Place = tuple[float, float]


@dataclass(frozen=True)
class Damping:
    """Damping in proportion to the whole model: β [-], η [1/s²], a [1/s], b [s]; β ∝ f^exponent, as at 100 Hz."""

    beta: float = 0.0
    eta: float = 0.0
    a: float = 0.0
    b: float = 0.0
    # What each mode's damping is times, the lowest first; modes beyond have 1 [-].
    scatter: tuple[float, ...] = ()
    exponent: float = 0.0

    def kappa(self, s: np.ndarray) -> np.ndarray:
        """What K is times at each s.

        With an exponent n a fractional Kelvin–Voigt term c sⁿ, c of the loss β at 100 Hz, and E the modulus there.
        """
        if not self.exponent:
            return 1 + 1j * self.beta + s * self.b
        at = 200 * np.pi
        strength = self.beta / (at**self.exponent * np.sin(self.exponent * np.pi / 2))
        term = strength * (s**self.exponent - ((1j * at) ** self.exponent).real)
        return 1 + term + s * self.b


@dataclass(frozen=True)
class Chain:
    """How the motion becomes a reading.

    Args:
        rate: of the exponential window on the response record [1/s].
        delay: of the response channel [s].
        gain: of all channels [-].
        offset: how far each response sits off its label (dx, dy) [m].
        sign: ±1 for each pair.
        reading: which pair, counted along the references first, is read under each label.
        calibration: gain of each pair [-], from one of its response and one of its reference channel.
        drift: of all natural frequencies in the record of each reference, relative [-].
        sensor_mass: that moves from response to response with the sensor [kg].
    """

    rate: float = 0.0
    delay: float = 0.0
    gain: float = 1.0
    offset: dict[int, tuple[float, float]] | None = None
    sign: np.ndarray | None = None
    reading: np.ndarray | None = None
    calibration: np.ndarray | None = None
    drift: np.ndarray | None = None
    sensor_mass: float = 0.0


@dataclass(frozen=True)
class Test:
    """Where and at which lines a plate was tested; places are those the labels stand for."""

    __test__ = False

    response: Sequence[Place]
    reference: Sequence[Place]
    frequency: np.ndarray  # [Hz]
    kind: str

    def laplace(self, rate: float) -> np.ndarray:
        """S = iω + rate [1/s]."""
        return 2j * np.pi * self.frequency + rate


def frf(plate: RitzPlate, damping: Damping, chain: Chain, test: Test, n_span: int = N_SPAN) -> np.ndarray:
    """The FRFs as they are read [n_frequency, n_response, n_reference]."""

    def read(chain: Chain, test: Test) -> np.ndarray:
        s = test.laplace(chain.rate)
        found, places = modes(plate, n_span), sat(plate, chain, test)
        if not chain.sensor_mass:
            return observe(receptance(found, plate, damping, s, places, test.reference), chain, test)
        inertia, loaded = (chain.sensor_mass * s**2)[:, None], []
        for at in places:
            # Every response is a plate of its own.
            if chain.sensor_mass > LIGHT * plate.mass:
                found = modes(replace(plate, loaded=(at,)), n_span)
            loaded.append(attach(receptance(found, plate, damping, s, [at, at], [at, *test.reference]), inertia))
        return observe(np.concatenate(loaded, axis=1), chain, test)

    return recorded(read, chain, test)


def recorded(read: Callable[[Chain, Test], np.ndarray], chain: Chain, test: Test) -> np.ndarray:
    """What a test reads whose frequencies drift from record to record, and whose channels have gains of their own.

    With (1 + δ)² K in place of K the receptance is H(s / (1 + δ)) / (1 + δ)². One record for each reference.

    Args:
        read: the FRFs of a test without either.
        chain: of the test.
        test: where and at which lines.
    """
    if chain.drift is None and chain.calibration is None:
        return read(chain, test)
    plain = replace(chain, sign=None, reading=None, calibration=None, drift=None)
    drift = np.zeros(len(test.reference)) if chain.drift is None else chain.drift
    found = []
    for place, off in zip(test.reference, drift, strict=True):
        own = replace(test, reference=[place], frequency=test.frequency / (1 + off))
        found.append(read(plain, own) * (1 + off) ** (DERIVATIVE[test.kind] - 2))
    whole = np.concatenate(found, axis=2)
    return relabelled(whole if chain.calibration is None else whole * chain.calibration, chain)


def sat(plate: RitzPlate, chain: Chain, test: Test) -> list[Place]:
    """Where the response sensors really sit."""
    lx, ly = plate.sides
    moved = chain.offset or {}
    pairs = [(place, moved.get(index, (0.0, 0.0))) for index, place in enumerate(test.response)]
    return [(x + dx / lx, y + dy / ly) for (x, y), (dx, dy) in pairs]


def observe(motion: np.ndarray, chain: Chain, test: Test) -> np.ndarray:
    """From receptances to readings."""
    s = test.laplace(chain.rate)
    factor = s ** DERIVATIVE[test.kind] * np.exp(-s * chain.delay) * chain.gain
    return relabelled(motion * factor[:, None, None], chain)


def relabelled(read: np.ndarray, chain: Chain) -> np.ndarray:
    """With the wrong signs and labels of a test."""
    if chain.sign is not None:
        read = read * chain.sign
    if chain.reading is not None:
        shape = read.shape
        read = read.reshape(shape[0], -1)[:, chain.reading].reshape(shape)
    return read


def receptance(
    found: Modes,
    plate: RitzPlate,
    damping: Damping,
    s: np.ndarray,
    response: Sequence[Place],
    reference: Sequence[Place],
    modulus: np.ndarray | None = None,
) -> np.ndarray:
    """Receptance [m/N] at each s [n_s, n_response, n_reference].

    Args:
        found: undamped modes of the plate.
        plate: whose dashpots are attached.
        damping: of the whole model.
        s: Laplace variable [1/s].
        response: where motion is read.
        reference: where forces act.
        modulus: g(s), what the plate's stiffness is times at each line; its springs stay.
    """
    dashpots = np.array(plate.dashpots).reshape(-1, 3)
    at = dashpots[:, :2].tolist()
    dynamic = s[:, None] * dashpots[:, 2]
    kappa = damping.kappa(s)
    if modulus is not None:
        springs = np.array(plate.springs).reshape(-1, 3)
        at = at + springs[:, :2].tolist()
        dynamic = np.concatenate([dynamic, (kappa * (1 - modulus))[:, None] * springs[:, 2]], axis=1)
        kappa = kappa * modulus
    if getattr(plate, "absorbers", ()):
        where, forces = plate.forces(s)
        at, dynamic = at + where, np.concatenate([dynamic, forces], axis=1)
    mu = 1j * damping.eta + s * damping.a + s**2
    left = found.deflection([*at, *response])
    right = found.deflection([*at, *reference])
    alpha = modal_sum(found, damping, kappa, mu, left, right, np.array(plate.dashpots).reshape(-1, 3))
    return attach(alpha, dynamic)


def scattered(found: Modes, damping: Damping, dashpots: np.ndarray) -> np.ndarray | None:
    """What each mode's damping has beyond its law, as a hysteretic term i (f − 1) d_r [n_mode] [rad²/s²].

    d_r = β ω² + η + a ω + b ω³ + ω Σ c φ² + φᵀHφ at the mode's own ω.
    """
    if not damping.scatter:
        return None
    omega = np.sqrt(found.eigenvalue.clip(0.0))
    law = (omega.clip(1e-3) / (200 * np.pi)) ** damping.exponent
    own = damping.beta * law * omega**2 + damping.eta + damping.a * omega + damping.b * omega**3
    if len(dashpots):
        own = own + omega * (dashpots[:, 2] @ found.deflection(dashpots[:, :2].tolist()) ** 2)
    if found.matrices.hysteretic is not None:
        own = own + np.einsum("im,ij,jm->m", found.shape, found.matrices.hysteretic, found.shape, optimize=True)
    factor = np.ones(len(omega))
    n = min(len(factor), len(damping.scatter))
    factor[:n] = damping.scatter[:n]
    return 1j * (factor - 1) * own


def modal_sum(
    found: Modes,
    damping: Damping,
    kappa: np.ndarray,
    mu: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    dashpots: np.ndarray | None = None,
) -> np.ndarray:
    """Σ_r left_r right_r / (κ ω_r² + μ) [n_s, n_left, n_right]; with H over complex modes."""
    shape = (len(mu), len(left), len(right))
    value: np.ndarray = kappa[:, None] * found.eigenvalue
    extra = scattered(found, damping, np.zeros((0, 3)) if dashpots is None else dashpots)
    if found.matrices.hysteretic is not None:
        if damping.b or damping.exponent:
            raise NotImplementedError("Elements with a loss of their own beside a loss that goes with the frequency.")
        # κ does not depend on s here.
        value, left, right = complex_modes(found, complex(kappa[0]), left, right, extra)
    elif extra is not None:
        value = value + extra
    pairs = (left[:, None] * right[None]).reshape(-1, left.shape[-1]).T
    inverse = 1 / (value + mu[:, None])
    if np.iscomplexobj(pairs):
        return (inverse @ pairs).reshape(shape)
    return (inverse.real @ pairs + 1j * (inverse.imag @ pairs)).reshape(shape)


def complex_modes(
    found: Modes, kappa: complex, left: np.ndarray, right: np.ndarray, extra: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues of κK + iH, and left and right over its complex modes.

    In a basis of the lowest modes, what H makes of them statically, twice over, and static shapes under the forces: all
    modes would take a minute, and the lowest alone converge slowly across a patch's edge.
    """
    coupling = found.shape.T @ found.matrices.hysteretic @ found.shape
    unit = np.eye(len(found.eigenvalue))[:, :N_LOW]
    soft = 1 / found.eigenvalue[:, None]
    once = soft * coupling[:, :N_COUPLED]
    static = soft * np.vstack([left, right]).T
    columns = np.hstack([unit, once, soft * (coupling @ once), static])
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    stiffness = basis.T @ (found.eigenvalue[:, None] * basis)
    whole = kappa * stiffness + 1j * basis.T @ coupling @ basis
    if extra is not None:
        whole = whole + basis.T @ (extra[:, None] * basis)
    value, vector = np.linalg.eig(whole)
    back = np.linalg.solve(vector, (basis.T @ right.T).astype(complex))
    return value, left @ basis @ vector, back.T


def attach(alpha: np.ndarray, dynamic: np.ndarray) -> np.ndarray:
    """Receptances with a dynamic stiffness at each of the first points, by Woodbury; those points are then cut off.

    Args:
        alpha: [n_s, n_attached + n_response, n_attached + n_reference].
        dynamic: [n_s, n_attached] [N/m].
    """
    n = dynamic.shape[1]
    if n == 0:
        return alpha
    own = np.eye(n) + dynamic[:, :, None] * alpha[:, :n, :n]
    force = np.linalg.solve(own, dynamic[:, :, None] * alpha[:, :n, n:])
    return alpha[:, n:, n:] - alpha[:, n:, :n] @ force
