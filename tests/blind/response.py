"""What a sensor would read of a Ritz plate: FRFs with all damping, the window and the sensor chain.

Z(s) = g(s) K (1 + iβ + s b) + M (iη + s a + s²) + iH + s C, with s = iω + rate. Undamped modes make all but C and H
diagonal; H is taken along by complex modes, C and whatever else sits at points by the Woodbury identity at every line.

Source: the seed paper, Eq. 17–18; Ewins, Modal Testing (2000); Fladung and Rost, MSSP 11 (1997) 23, for the window.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from blind.ritz import N_SPAN, Modes, RitzPlate, modes

DERIVATIVE = {"receptance": 0, "mobility": 1, "accelerance": 2}
# Modes kept beside a damping patch, some four times the band, and those whose coupling by it is followed.
N_LOW, N_COUPLED = 60, 35
Place = tuple[float, float]


@dataclass(frozen=True)
class Damping:
    """Damping in proportion to the whole model: β [-], η [1/s²], a [1/s], b [s]."""

    beta: float = 0.0
    eta: float = 0.0
    a: float = 0.0
    b: float = 0.0


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
    """

    rate: float = 0.0
    delay: float = 0.0
    gain: float = 1.0
    offset: dict[int, tuple[float, float]] | None = None
    sign: np.ndarray | None = None
    reading: np.ndarray | None = None


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
    s = test.laplace(chain.rate)
    return observe(
        receptance(modes(plate, n_span), plate, damping, s, sat(plate, chain, test), test.reference), chain, test
    )


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
    read = motion * factor[:, None, None]
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
    kappa = 1 + 1j * damping.beta + s * damping.b
    if modulus is not None:
        springs = np.array(plate.springs).reshape(-1, 3)
        at = at + springs[:, :2].tolist()
        dynamic = np.concatenate([dynamic, (kappa * (1 - modulus))[:, None] * springs[:, 2]], axis=1)
        kappa = kappa * modulus
    mu = 1j * damping.eta + s * damping.a + s**2
    left = found.deflection([*at, *response])
    right = found.deflection([*at, *reference])
    alpha = modal_sum(found, damping, kappa, mu, left, right)
    return attach(alpha, dynamic)


def modal_sum(
    found: Modes, damping: Damping, kappa: np.ndarray, mu: np.ndarray, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Σ_r left_r right_r / (κ ω_r² + μ) [n_s, n_left, n_right]; with H over complex modes."""
    shape = (len(mu), len(left), len(right))
    value: np.ndarray = kappa[:, None] * found.eigenvalue
    if found.matrices.hysteretic is not None:
        if damping.b:
            raise NotImplementedError("A damping patch with stiffness-proportional viscous damping.")
        # κ does not depend on s here.
        value, left, right = complex_modes(found, complex(kappa[0]), left, right)
    pairs = (left[:, None] * right[None]).reshape(-1, left.shape[-1]).T
    inverse = 1 / (value + mu[:, None])
    if np.iscomplexobj(pairs):
        return (inverse @ pairs).reshape(shape)
    return (inverse.real @ pairs + 1j * (inverse.imag @ pairs)).reshape(shape)


def complex_modes(
    found: Modes, kappa: complex, left: np.ndarray, right: np.ndarray
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
    value, vector = np.linalg.eig(kappa * stiffness + 1j * basis.T @ coupling @ basis)
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
