"""torchplate: model updating of plates from measured vibration, as batched torch tensors.

- `plate`: geometry in, matrices out.
- `effects`: the catalogue, one physical effect per file.
- `model`: what a sensor would read: natural frequencies and frequency response functions.
- `measurement`: what a sensor did read.
- `search`: minimise on the unit cube; knows nothing of plates.
- `discrepancy`: the gap between the two.
- `identification`: the values of the searched parameters that make it least, and how far to trust them.
- `diagnosis`: where it comes from: the missing effect, named and added.
- `report`: results as people read them; writes no file.
- `planning`: the next test, which would part the names that a diagnosis leaves open.
- `bench`: how fast, beside what else there is.
- `cli`: YAML in, `runs/` out.
- `studies`: what the project shows of itself, a command each; nothing here imports them.
- `examples`: the FRF embedded in torch, to copy from; nothing here imports them.
- `nearest`: the name that was probably meant.
- `notation`: percentages, written in one way.

The names below are public, and each is imported when it is first asked for, so that `torchplate --help` need not wait
for torch:

>>> import torchplate as tp
>>> tp.DifferentialEvolution(strategy="best/1/exp").n_member
32
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchplate.cli.config.build import load_model
    from torchplate.diagnosis import Diagnosis, diagnose
    from torchplate.diagnosis.change import PlateTest, what_changed
    from torchplate.effects import CATALOGUE
    from torchplate.identification import PlateState, Result, States, identify
    from torchplate.measurement import (
        Measurement,
        ModalModel,
        modes,
        read_measurement,
        read_modal_model,
        simulate,
        write_modal_model,
        write_uff,
    )
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

    __version__: str

__all__ = [
    "CATALOGUE",
    "OPTIMIZERS",
    "ArtificialBeeColony",
    "Diagnosis",
    "DifferentialEvolution",
    "Jde",
    "LShade",
    "Measurement",
    "ModalModel",
    "Outcome",
    "PlateModel",
    "PlateState",
    "PlateTest",
    "Result",
    "Sade",
    "States",
    "Status",
    "__version__",
    "diagnose",
    "identify",
    "load_model",
    "minimize",
    "modes",
    "read_measurement",
    "read_modal_model",
    "reduce",
    "simulate",
    "what_changed",
    "write_modal_model",
    "write_uff",
]

_HOME = {
    "cli.config.build": ("load_model",),
    "diagnosis": ("Diagnosis", "diagnose"),
    "diagnosis.change": ("PlateTest", "what_changed"),
    "effects": ("CATALOGUE",),
    "identification": ("PlateState", "Result", "States", "identify"),
    "measurement": (
        "Measurement",
        "ModalModel",
        "modes",
        "read_measurement",
        "read_modal_model",
        "simulate",
        "write_modal_model",
        "write_uff",
    ),
    "model": ("PlateModel", "reduce"),
    "search": (
        "OPTIMIZERS",
        "ArtificialBeeColony",
        "DifferentialEvolution",
        "Jde",
        "LShade",
        "Outcome",
        "Sade",
        "Status",
        "minimize",
    ),
}
_ROOM = {name: room for room, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    """A public name from the room it lives in, or a room; then it stays."""
    value: Any
    if name == "__version__":
        from torchplate.cli.machine.installed import version_of

        value = version_of("torchplate-fem")
    elif name in _ROOM:
        value = getattr(import_module(f"{__name__}.{_ROOM[name]}"), name)
    elif not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """What completion offers."""
    return sorted({*globals(), *__all__})
