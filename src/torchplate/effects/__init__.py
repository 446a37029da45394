"""The catalogue of physical effects, one per file.

`effect` says what an effect is and keeps the catalogue, `parameter` what one of its numbers is; every other file holds
one effect. A new effect is a new file and one more import below.
"""

from torchplate.effects.absorber import Absorber
from torchplate.effects.air_loading import AirLoading
from torchplate.effects.aspect_ratio import AspectRatio
from torchplate.effects.channel_polarity import ChannelPolarity
from torchplate.effects.channel_swap import ChannelSwap
from torchplate.effects.cut_out import CutOut
from torchplate.effects.damping_patch import DampingPatch
from torchplate.effects.density import Density
from torchplate.effects.directional_damping import DirectionalDamping
from torchplate.effects.edge_spring import EdgeSpring
from torchplate.effects.effect import CATALOGUE, Channel, Check, Effect, SensorChain, find_effect, options
from torchplate.effects.exponential_window import ExponentialWindow
from torchplate.effects.field import DIRECTIONS, KINDS, Field
from torchplate.effects.frequency_dependent_loss import FrequencyDependentLoss
from torchplate.effects.grain_angle import GrainAngle
from torchplate.effects.ground_dashpot import GroundDashpot
from torchplate.effects.ground_spring import GroundSpring
from torchplate.effects.hysteretic_damping import HystereticDamping
from torchplate.effects.mesh_discretisation import MeshDiscretisation
from torchplate.effects.orthotropy import Orthotropy
from torchplate.effects.parameter import Interval, Parameter, Prior, Searched, plate_scale
from torchplate.effects.plate import Plate
from torchplate.effects.point_mass import PointMass
from torchplate.effects.poisson_ratio import PoissonRatio
from torchplate.effects.rib import Rib
from torchplate.effects.roving_mass import RovingMass
from torchplate.effects.sensor_gain import SensorGain
from torchplate.effects.sensor_position import SensorPosition
from torchplate.effects.stiffness_loss import StiffnessLoss
from torchplate.effects.support_asymmetry import SupportAsymmetry
from torchplate.effects.support_spring import SupportSpring, SupportTerms
from torchplate.effects.thickness import Thickness
from torchplate.effects.thickness_field import ThicknessField
from torchplate.effects.thickness_taper import ThicknessTaper
from torchplate.effects.time_delay import TimeDelay
from torchplate.effects.viscous_damping import ViscousDamping

__all__ = [
    "CATALOGUE",
    "DIRECTIONS",
    "KINDS",
    "Absorber",
    "AirLoading",
    "AspectRatio",
    "Channel",
    "ChannelPolarity",
    "ChannelSwap",
    "Check",
    "CutOut",
    "DampingPatch",
    "Density",
    "DirectionalDamping",
    "EdgeSpring",
    "Effect",
    "ExponentialWindow",
    "Field",
    "FrequencyDependentLoss",
    "GrainAngle",
    "GroundDashpot",
    "GroundSpring",
    "HystereticDamping",
    "Interval",
    "MeshDiscretisation",
    "Orthotropy",
    "Parameter",
    "Plate",
    "PointMass",
    "PoissonRatio",
    "Prior",
    "Rib",
    "RovingMass",
    "Searched",
    "SensorChain",
    "SensorGain",
    "SensorPosition",
    "StiffnessLoss",
    "SupportAsymmetry",
    "SupportSpring",
    "SupportTerms",
    "Thickness",
    "ThicknessField",
    "ThicknessTaper",
    "TimeDelay",
    "ViscousDamping",
    "find_effect",
    "options",
    "plate_scale",
]
