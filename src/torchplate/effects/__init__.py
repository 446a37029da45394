"""The catalogue of physical effects, one per file.

`effect` says what an effect is and keeps the catalogue; every other file holds one effect. A new effect is a new file
and one more import below.
"""

from torchplate.effects.effect import (
    CATALOGUE,
    Effect,
    Interval,
    Parameter,
    SensorChain,
    find_effect,
    options,
)
from torchplate.effects.exponential_window import ExponentialWindow
from torchplate.effects.hysteretic_damping import HystereticDamping
from torchplate.effects.plate import Plate
from torchplate.effects.point_mass import PointMass
from torchplate.effects.support_spring import SupportSpring
from torchplate.effects.viscous_damping import ViscousDamping

__all__ = [
    "CATALOGUE",
    "Effect",
    "ExponentialWindow",
    "HystereticDamping",
    "Interval",
    "Parameter",
    "Plate",
    "PointMass",
    "SensorChain",
    "SupportSpring",
    "ViscousDamping",
    "find_effect",
    "options",
]
