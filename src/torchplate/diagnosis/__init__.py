"""Where simulation and measurement disagree, which effect is missing, and the gap once it is added.

- `flow`: the steps; `settings`: what is taken for granted, with its reasons.
- `candidates`: what may be missing; `selection`: which of it is added.
- `table`: the same for a table of natural frequencies, where every hypothesis can be weighed.
- `change`: what has changed between two tests of one plate.
- `integral`: the likelihood of a hypothesis over all its values, where that takes no longer than to fit it.
- `holdout`: the FRFs that no fit sees; `tolerance`: numbers that are known as well as a ruler knows them; `usual`:
  priors of which half is narrow.
- `target`: what the models are held against, and residuals from wide to sharp; `smoothing`: of the wide ones; `lines`:
  which of a large test are looked at.
- `model_builder`: one mesh for all models, its error taken off, and bases that are right where they are used.
- `fit`: the refit of one hypothesis; `joint`: its parameters and the specimen at once; `problem`: its residuals, and
  the ways down; `judged`: it beside noise and nuisances; `basins`: where it begins when nothing is known.
- `localisation`: where the misfit sits: in frequency, in the channels, on the plate, and of which kind it is.
- `field`: where nothing of the catalogue accounts for what is left, a map without a name.
- `freed_memory`: goes back to the system before much more is taken; `one_thread`: is all that any of this takes.
- `assurance`: FRAC, CSAC, CSF and FDAC of what was measured with a model.
- `next_measurement`: the cheapest measurement that would part equivalents.
- `summary`: what is said of all this; `before_and_after`: of any two fits of one test; `naming`: of an effect that is
  named; `estimates`: its numbers with their intervals; `posterior`: how well these are known; `remarks`: of what is
  missing still; `result`: the object that holds it all.
- `rivals`: the hypotheses that are left open, as data; `doubts`: which they are.
"""

from torchplate.diagnosis.assurance import csac_by_line, csf_by_line, fdac, fdac_frequency, frac_by_channel
from torchplate.diagnosis.candidates.catalogue import channels_of
from torchplate.diagnosis.change import PlateTest, what_changed
from torchplate.diagnosis.flow import diagnose
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.one_thread import one_thread
from torchplate.diagnosis.result import (
    FIRST_REFIT,
    ONE_FORCE,
    ChannelGap,
    Diagnosis,
    Estimate,
    FoundField,
    Location,
    Named,
    Overlay,
    Scored,
    Step,
)
from torchplate.diagnosis.rivals import SCHEMA, Doubt, Rival
from torchplate.diagnosis.selection.forward import ForwardSelection
from torchplate.diagnosis.settings import SETTINGS, DiagnosisSettings
from torchplate.diagnosis.table import fitted_table
from torchplate.diagnosis.target import FrfTarget

__all__ = [
    "FIRST_REFIT",
    "ONE_FORCE",
    "SCHEMA",
    "SETTINGS",
    "ChannelGap",
    "Diagnosis",
    "DiagnosisSettings",
    "Doubt",
    "Estimate",
    "ForwardSelection",
    "FoundField",
    "FrfTarget",
    "Location",
    "ModelBuilder",
    "Named",
    "Overlay",
    "PlateTest",
    "Rival",
    "Scored",
    "Step",
    "channels_of",
    "csac_by_line",
    "csf_by_line",
    "diagnose",
    "fdac",
    "fdac_frequency",
    "fitted_table",
    "frac_by_channel",
    "one_thread",
    "what_changed",
]
