"""What a config may hold: every key with its kind, unit, default, meaning and an example.

The only files that import pydantic. The reference of the documentation, `torchplate keys` and the sentences about
unknown keys all follow from the models here. `config` reads the file.

- `key`: how a key is declared; `numbers`: a number or an interval; `quantity`: either as it is written;
  `truth`: no truth value is a number.
- `measured`: the section `measurement`, and the states of a plate; `whole`: all others, and the config of them.
- `validation`: from a mapping to a checked config; `complaint`: what is wrong with one, in a sentence.
"""

from torchplate.cli.schema.complaint import EFFECT_PAGE, KEY_PAGE, ConfigError, misplaced, model_in, unknown_key
from torchplate.cli.schema.measured import FrameConfig, MeasurementConfig, StateConfig
from torchplate.cli.schema.numbers import Known, Unknown
from torchplate.cli.schema.quantity import quantity, typed
from torchplate.cli.schema.validation import validated, validated_states
from torchplate.cli.schema.whole import Config, MeshConfig, SearchConfig

__all__ = [
    "EFFECT_PAGE",
    "KEY_PAGE",
    "Config",
    "ConfigError",
    "FrameConfig",
    "Known",
    "MeasurementConfig",
    "MeshConfig",
    "SearchConfig",
    "StateConfig",
    "Unknown",
    "misplaced",
    "model_in",
    "quantity",
    "typed",
    "unknown_key",
    "validated",
    "validated_states",
]
