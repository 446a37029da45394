"""torchplate: model updating of plates from measured vibration, as batched torch tensors.

- `plate`: geometry in, matrices out.
- `effects`: the catalogue, one physical effect per file.
- `model`: what a sensor would read: natural frequencies and frequency response functions.
- `measurement`: what a sensor did read.
- `search`: minimise on the unit cube; knows nothing of plates.
- `discrepancy`: the gap between the two.
- `identification`: the values of the searched parameters that make it least, and how far to trust them.
- `diagnosis`: where it comes from: the missing effect, named and added.
- `bench`: how fast, beside what else there is.
- `cli`: YAML in, `runs/` out.
- `examples`: the FRF embedded in torch, to copy from; nothing here imports them.

The names below are public:

>>> import torchplate as tp
>>> tp.DifferentialEvolution(strategy="best/1/exp").n_member
32
"""

from importlib.metadata import version

from torchplate.cli.build import load_model
from torchplate.diagnosis import Diagnosis, diagnose
from torchplate.effects import CATALOGUE
from torchplate.identification import Result, identify
from torchplate.measurement import Measurement, read_measurement, write_uff
from torchplate.model import PlateModel, reduce
from torchplate.search import (
    OPTIMIZERS,
    ArtificialBeeColony,
    DifferentialEvolution,
    Jde,
    LShade,
    Outcome,
    Sade,
    Status,
    minimize,
)

__version__ = version("torchplate-fem")

__all__ = [
    "CATALOGUE",
    "OPTIMIZERS",
    "ArtificialBeeColony",
    "Diagnosis",
    "DifferentialEvolution",
    "Jde",
    "LShade",
    "Measurement",
    "Outcome",
    "PlateModel",
    "Result",
    "Sade",
    "Status",
    "__version__",
    "diagnose",
    "identify",
    "load_model",
    "minimize",
    "read_measurement",
    "reduce",
    "write_uff",
]
