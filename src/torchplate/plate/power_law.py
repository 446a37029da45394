"""A loss factor that goes with a power of the frequency, and the modulus that causality ties to it.

One fractional term, E ∝ 1 + c (iω/ω₀)ⁿ, has the loss β (ω/ω₀)ⁿ if c sin(nπ/2) = β, and with it the modulus

    1 + β cot(nπ/2) ((ω/ω₀)ⁿ − 1),

taken as 1 at ω₀ (Kramers and Kronig; Bagley and Torvik, J. Rheol. 27 (1983) 201). As n goes to zero that does not
vanish: a constant loss asks for a modulus that grows by 2β/π with ln ω, of which the plain loss factor of Eq. 17 knows
nothing. So that an exponent of zero is that plain loss, the modulus fades in over exponents of some `FADES`.
"""

import math

import torch
from jaxtyping import Complex, Float
from torch import Tensor

# Where the loss factor is β [Hz]; below the lowest the law is held as it is there.
REFERENCE_FREQUENCY, LOWEST_FREQUENCY = 100.0, 0.1
# An exponent this small changes a loss by 2 % over a decade: nobody can tell it from zero.
FADES = 0.01


def power_law(
    exponent: Float[Tensor, "*#batch"] | float, laplace: Complex[Tensor, "*#batch n_frequency"]
) -> Complex[Tensor, "*batch n_frequency"]:
    """What β is times in κ = 1 + β (…): i for an exponent of zero.

    Args:
        exponent: n [-], from −1 to 1.
        laplace: s [1/s].
    """
    n = torch.as_tensor(exponent).to(laplace.real)[..., None]
    reference, lowest = 2 * math.pi * REFERENCE_FREQUENCY, 2 * math.pi * LOWEST_FREQUENCY
    s = torch.where(laplace.abs() < lowest, torch.full_like(laplace, 1j * lowest), laplace)
    grown = torch.exp(n * torch.log(s / (1j * reference)))
    # n cot(nπ/2), which is smooth at zero.
    cotangent = 2 / math.pi * torch.cos(0.5 * math.pi * n) / torch.sinc(0.5 * n)
    return 1j * grown + cotangent * n / (n**2 + FADES**2) * (grown - 1)
