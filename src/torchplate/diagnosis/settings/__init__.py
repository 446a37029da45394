"""What a diagnosis takes for granted: every number that somebody chose, by stage, with its unit and its reason.

- `whole`: all of them.
- `evidence`: what is looked at, and how hypotheses are compared; `fitting`: meshes, levels, one fit; `selection`: what
  is tried, refitted, added; `field`: what is inferred where nothing of it accounts for the data.

The diagnosis of a table has its own, `table.settings`. What nobody chose stands where it is used: steps of differences,
what counts as rounding, and numbers that follow from a definition.
"""

from torchplate.diagnosis.settings.evidence import Comparison, HoldingOut, Lines, Localising
from torchplate.diagnosis.settings.field import FieldInference
from torchplate.diagnosis.settings.fitting import Fineness, Fitting, Meshes, Searching, WideLevels
from torchplate.diagnosis.settings.selection import Screening, Selecting, Trials
from torchplate.diagnosis.settings.whole import SETTINGS, DiagnosisSettings

__all__ = [
    "SETTINGS",
    "Comparison",
    "DiagnosisSettings",
    "FieldInference",
    "Fineness",
    "Fitting",
    "HoldingOut",
    "Lines",
    "Localising",
    "Meshes",
    "Screening",
    "Searching",
    "Selecting",
    "Trials",
    "WideLevels",
]
