"""A run's config: from its YAML file to the model, the evidence and the search that it asks for.

- `file`: the YAML file, read and checked, and the error that says what is wrong with it (the only file with yaml).
- `recipe`: a checked config and the plate it describes; `measured`: with what was measured; `searches`: the searches
  that it can ask for; `build`: from all of these to model, evidence and objective.
- `plate_test`: a config as a test that a diagnosis or a plan takes.
- `memory`: whether its mesh fits the machine; `odd_values`: numbers that may be and that hardly anybody means.
"""

from torchplate.cli.config.file import InputError, dump, read_config

__all__ = ["InputError", "dump", "read_config"]
