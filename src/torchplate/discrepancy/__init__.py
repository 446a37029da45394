"""The gap between simulation and measurement: how wide it is, and what the data can see.

- `measure`: what a measure of the gap between FRFs is, and the registry `OBJECTIVES`; `norms` (relative, logarithmic,
  weighed by the coherence) and `assurance` (FRAC, CSAC, CSF) hold the registered functions. `assurance` has MAC and
  COMAC of mode shapes, too.
- `natural_frequency`: the gap between tables of natural frequencies.
- `modal_evidence`: the gap between a modal model and the model's modes, paired by their shapes.
- `level`, `deviation`: what a measure is made of: the fitted level where readings carry no unit, and residuals.
- `objective`: the function of theta that a search minimises.
- `sensitivity`: what a small change of each parameter does to the prediction: uncertainty, and blind directions.
- `nuisance`: what every test has and nobody wants named, as changes of the FRFs; `modal_change`: by modes;
  `second_order`: what such a change leaves out; `places`: sensors, hits and supports off their marks; `drive_point`:
  where a hit and a sensor are at one place; `wandering`: a plate whose section is not the same everywhere; `specimen`:
  the plate that was measured, as far as it is known how far it is off.
- `marginal`: the likelihood with all that integrated out; `columns`: products with what is integrated out; `judged`:
  what it says of residuals.
- `covariance`: from the Jacobian and the noise of every residual to standard errors and correlations.
"""

from torchplate.discrepancy.assurance import comac, csac, csf, frac, mac
from torchplate.discrepancy.covariance import Rows
from torchplate.discrepancy.judged import Judged, Knowledge
from torchplate.discrepancy.marginal import Marginal
from torchplate.discrepancy.measure import OBJECTIVES, Measured
from torchplate.discrepancy.modal_evidence import ModalEvidence, ModePair
from torchplate.discrepancy.norms import coherence_weighted, log_amplitude, relative_amplitude_norm, relative_frf_norm
from torchplate.discrepancy.nuisance import (
    FREE,
    Nuisances,
    matrix_columns,
    modes_damped,
    nuisances,
    place_std,
    real_columns,
    specimen_columns,
)
from torchplate.discrepancy.objective import Evidence, Objective
from torchplate.discrepancy.sensitivity import Sensitivity, sensitivity
from torchplate.discrepancy.specimen import Found, OfChannels, Specimens, as_it_is_meant
from torchplate.discrepancy.wandering import UNIFORM, Elements, Wandering, n_terms, section_off

__all__ = [
    "FREE",
    "OBJECTIVES",
    "UNIFORM",
    "Elements",
    "Evidence",
    "Found",
    "Judged",
    "Knowledge",
    "Marginal",
    "Measured",
    "ModalEvidence",
    "ModePair",
    "Nuisances",
    "Objective",
    "OfChannels",
    "Rows",
    "Sensitivity",
    "Specimens",
    "Wandering",
    "as_it_is_meant",
    "coherence_weighted",
    "comac",
    "csac",
    "csf",
    "frac",
    "log_amplitude",
    "mac",
    "matrix_columns",
    "modes_damped",
    "n_terms",
    "nuisances",
    "place_std",
    "real_columns",
    "relative_amplitude_norm",
    "relative_frf_norm",
    "section_off",
    "sensitivity",
    "specimen_columns",
]
