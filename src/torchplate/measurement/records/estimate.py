"""FRFs and coherence from cut hits: windows, averaged spectra, H1, H2 and Hv.

Sources: Bendat and Piersol, Random Data (4th ed., 2010), chapters 6 and 9; Shin and Hammond, Fundamentals of Signal
Processing for Sound and Vibration Engineers (2008), section 9.3 (Hv); Fladung, Windows Used for Impact Testing (IMAC
1997).
"""

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from torchplate.measurement.records.recording import Hits

Estimate = Literal["H1", "H2", "Hv"]
ESTIMATES: Final[tuple[Estimate, ...]] = get_args(Estimate)


@dataclass(frozen=True)
class Windows:
    """Windows over each record; both start where the record starts.

    Args:
        force: Time after which the force counts as zero [s], with a cosine of a tenth of it at the end; None for none.
        exponential: Time constant τ of exp(−t/τ) on force and responses [s]; None for none. On both, the model's
            effect `exponential_window` with rate 1/τ takes it off again.

    Raises:
        ValueError: A window of no length.
    """

    force: float | None = None
    exponential: float | None = None

    def __post_init__(self) -> None:
        for name in ("force", "exponential"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ValueError(f"Expected a {name} window above 0 s, got {value:g}. Leave it out for none.")

    def over(self, n_sample: int, rate: float) -> tuple[np.ndarray, np.ndarray]:
        """The force's and the responses' window at each sample [-]."""
        time = np.arange(n_sample) / rate
        response = np.ones(n_sample) if self.exponential is None else np.exp(-time / self.exponential)
        force = response.copy()
        if self.force is not None:
            edge = np.clip((time - 0.9 * self.force) / (0.1 * self.force), 0, 1)
            force = force * (0.5 + 0.5 * np.cos(np.pi * edge))
        return force, response


class Estimated(NamedTuple):
    """FRFs of one reference.

    Attributes:
        frequency: [n_frequency] [Hz], from 0 to half the rate.
        frf: [n_frequency, n_response].
        coherence: [n_frequency, n_response]; 1 for a single hit, which says nothing.
    """

    frequency: np.ndarray
    frf: np.ndarray
    coherence: np.ndarray


def estimate(hits: Hits, windows: Windows | None = None, estimator: Estimate = "H1") -> Estimated:
    """Average the spectra of the hits: H1 = G_fx/G_ff, H2 = G_xx/G_xf, Hv between them with equal noise on both.

    Args:
        hits: Of one reference.
        windows: None for none.
        estimator: H1 is unbiased by noise on the responses, H2 by noise on the force.
    """
    n = hits.force.shape[1]
    force_window, response_window = (windows or Windows()).over(n, hits.rate)
    f = np.fft.rfft(hits.force * force_window)[:, None]
    x = np.fft.rfft(hits.response * response_window)
    ff, xx = (np.abs(f) ** 2).sum(axis=0), (np.abs(x) ** 2).sum(axis=0)
    fx = (f.conj() * x).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        if estimator == "H1":
            frf = fx / ff
        elif estimator == "H2":
            frf = xx * fx / np.abs(fx) ** 2
        else:
            frf = (xx - ff + np.sqrt((ff - xx) ** 2 + 4 * np.abs(fx) ** 2)) * fx / (2 * np.abs(fx) ** 2)
        coherence = np.abs(fx) ** 2 / (ff * xx)
    frf = np.where(np.isfinite(frf), frf, 0)
    coherence = np.clip(np.where(np.isfinite(coherence), coherence, 0), 0, 1)
    return Estimated(np.fft.rfftfreq(n, 1 / hits.rate), frf.T, coherence.T)
