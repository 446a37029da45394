"""Where simulation and measurement disagree, which effect is missing, and the gap once it is added.

- `road`: the steps from the given model to the last one: baseline, look, name, add, remove; `look`: one look over the
  whole catalogue: score, refit; `state`: where the road has come to.
- `noise`: the noise floor, from the measurement alone; `holdout`: the FRFs that no fit sees.
- `tolerance`: numbers that are known as well as a ruler knows them; `held_edges`: edges on springs that may yield.
- `target`: what the models are held against, and residuals from wide to sharp.
- `workbench`: one mesh for all models, its error taken off, and bases that are right where they are used.
- `rebuilding`: the same plate with other effects or other numbers.
- `candidate`: every effect of the catalogue that may be missing, with its options, places and sizes.
- `supports`: what is grounded at a place, taken for a support.
- `screen`: the score test over all of them; `null`: what chance alone would give in it; `fit`: the refit of one.
- `naming`: the best, its equivalents, how sure that is; `hindsight`: what earlier names are once later ones are known.
- `localise`: where the misfit sits: in frequency, in the channels, on the plate, and of which kind it is.
- `assurance`: FRAC, CSAC, CSF and FDAC of what was measured with a model.
- `next_measurement`: the cheapest measurement that would part equivalents.
- `summary`: what is said of all this; `ledger`: the object that holds it.
"""

from torchplate.diagnosis.ledger import Diagnosis
from torchplate.diagnosis.road import diagnose

__all__ = ["Diagnosis", "diagnose"]
