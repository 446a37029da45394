"""What a sensor would read: mesh and effects in, natural frequencies and frequency response functions out.

- `parameter_space`: what is searched; the unit cube against SI units.
- `modes`: batched natural frequencies and mode shapes.
- `frf`: receptances by modal sum, exact for local dashpots, and the direct solve that referees them.
- `plate_model`: the torch module that puts them together.
"""

from torchplate.model.modes import Modes
from torchplate.model.parameter_space import ParameterSpace, Searched
from torchplate.model.plate_model import PlateModel

__all__ = ["Modes", "ParameterSpace", "PlateModel", "Searched"]
