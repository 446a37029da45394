"""A plate that is stiffer along one side than along the other: rolled, printed, laminated."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, positive
from torchplate.plate import Mesh, Section

# A plate is a sheet of metal or it is wood or a laminate. The texture of rolled sheet makes E differ by a few per cent
# to some twenty between directions, by alloy (Davies, Goodwill and Kallend, Metallurgical Transactions 3 (1972) 1627).
ROLLED = 0.1


@dataclass(frozen=True)
class Orthotropy(Effect):
    """E_x = E/√r, E_y = E √r, G = g E / (2 (1 + ν)), with E = √(E_x E_y), ν = √(ν_x ν_y) and the axes along the sides.

    With g = 1 a plate of ratio r is nearly an isotropic one of the aspect ratio r^(−1/4): the two are close to twins.
    """

    parameters = {
        "young_ratio": Parameter(
            "-", "r = Ey/Ex, √(Ex·Ey) kept", positive, neutral=1.0, prior=Prior(0.03, 30.0, True, usual=ROLLED)
        ),
        "shear_factor": Parameter(
            "-", "g: G over its isotropic value", positive, neutral=1.0, prior=Prior(0.2, 5.0, True, usual=ROLLED)
        ),
    }
    check = Check(4, "test a strip cut along each side, or twist the plate statically: E_x, E_y and G part there")
    acts_on = frozenset({"section"})
    shows = (
        "Modes that bend along x and along y part, and modes that twist move alone where G is not the isotropic one."
    )
    source = "Lekhnitskii, Anisotropic Plates (1968)"

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The ratio and the shear modulus, times what they were."""
        return section._replace(
            young_ratio=section.young_ratio * value["young_ratio"][..., None],
            shear_factor=section.shear_factor * value["shear_factor"][..., None],
        )
