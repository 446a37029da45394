"""The diagnosis of a table of natural frequencies: every effect, and pairs of them, by marginal likelihood.

- `flow`: the steps; `settings`: every constant, with its reason.
- `evidence`: residuals, their scatter, and the one unknown factor on it.
- `plates`: the plate on the given and on the corrected mesh, in bases that are small and right.
- `natural`: natural frequencies of many members, and their derivatives.
- `hypotheses`: effects tried all over their intervals, where refits begin, which pairs promise most.
- `refit`: the minima of a hypothesis and its marginal likelihood; `whole_box`: the same over all values;
  `comparison`: of all hypotheses on one mesh.
- `posterior`: probabilities of hypotheses, of effects, of parameters; `null`: what chance alone would take.
- `found`: what all this has come to; `summary`: what is said of it; `naming`: of an effect that is named; `remarks`: of
  what is missing still.
- `asked`: what a table says of each effect and of pairs, where it is FRFs that are diagnosed.
"""

from torchplate.diagnosis.table.asked import Asked, Told
from torchplate.diagnosis.table.flow import FittedTable, diagnose_table, fitted_table

__all__ = ["Asked", "FittedTable", "Told", "diagnose_table", "fitted_table"]
