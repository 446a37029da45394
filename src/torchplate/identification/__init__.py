"""From a model and a measurement to the values of its searched parameters, their standard errors and what to know.

- `identify`: choose a basis, search, finish, confirm, say what was found.
- `states`: one plate in several states, as one objective; `identify_states`: the search of it.
- `job`: the search as one piece of work, the same on every process that shares it; its budget.
- `polish`: the finish of a search by least squares; `mesh_error`: taken off anew at what was found.
- `basis_check`: the basis that is searched in, chosen before the search and confirmed at its best member.
- `evaluation`: what is said of values: of a model alone, of what it is compared with, of the search that found them.
- `stretch`: by which factor a model's natural frequencies meet those of a test, a guess before any search;
  `another_plate`: what that says of a density, a modulus or a thickness that are not the plate's.
- `result`: what was found, as result.json holds it; `caveats`: what must be known before it is trusted;
  `odd_channels`: which channels are right but for a factor; `fit_quality`: how good the fit is, in words.
"""

from torchplate.identification.another_plate import another_plate
from torchplate.identification.evaluation import evaluated
from torchplate.identification.fit_quality import fit_in_words
from torchplate.identification.identify import Identified, identified, identify, nominal
from torchplate.identification.identify_states import StatesFound, identify_states
from torchplate.identification.job import Job, Settings
from torchplate.identification.mesh_error import retaken_told
from torchplate.identification.result import CORRELATED, Result, Value
from torchplate.identification.states import PlateState, States
from torchplate.identification.stretch import GRAINS, Stretch, coarse_cells, stretched

__all__ = [
    "CORRELATED",
    "GRAINS",
    "Identified",
    "Job",
    "PlateState",
    "Result",
    "Settings",
    "States",
    "StatesFound",
    "Stretch",
    "Value",
    "another_plate",
    "coarse_cells",
    "evaluated",
    "fit_in_words",
    "identified",
    "identify",
    "identify_states",
    "nominal",
    "retaken_told",
    "stretched",
]
