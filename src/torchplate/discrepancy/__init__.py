"""The gap between simulation and measurement: how wide it is, and what the data can see.

- `objective`: the registered measures of the gap, and the function of theta that a search minimises.
- `sensitivity`: what a small change of each parameter does to the prediction: uncertainty, and blind directions.
"""

from torchplate.discrepancy.objective import OBJECTIVES, Evidence, Objective, relative_frf_norm
from torchplate.discrepancy.sensitivity import Sensitivity, sensitivity

__all__ = ["OBJECTIVES", "Evidence", "Objective", "Sensitivity", "relative_frf_norm", "sensitivity"]
