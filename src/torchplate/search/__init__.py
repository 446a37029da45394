"""Minimise on the unit cube, as tensor operations. Knows nothing of plates.

- `optimizer`: what every optimiser is (ask, tell, frozen settings, returned state) and the registry `OPTIMIZERS`.
- `minimization`, `outcome`: the loop that counts, stops, reports and resumes; what it returns.
- `differential_evolution` (the ten classic variants), with `mutation`, `crossover`, `bounds` and `draws`, its parts;
  `jde`, `sade`, `l_shade`: those that set F, CR, strategy or population size themselves.
- `artificial_bee_colony`: employed bees, onlookers, scouts.
- `sharded`: an objective that the processes of a torch.distributed group evaluate together.
- `least_squares`, with `jacobian` and `least_squares_outcome`: bounded Levenberg-Marquardt, many starts in one batch;
  not an optimiser of the registry, for it needs residuals. `many_starts`: a search of the whole cube by it.
  `recall`: ends of its descents that an interrupted computation had made.

A new optimiser is one file with a frozen dataclass `class Mine(Optimizer[MineState], name="mine")` and one
line below; the registry, the generic tests and whatever lists the optimisers follow.
"""

from torchplate.search.artificial_bee_colony import ArtificialBeeColony
from torchplate.search.bounds import BOUNDS
from torchplate.search.differential_evolution import STRATEGIES, DifferentialEvolution
from torchplate.search.jacobian import JACOBIANS, Residual
from torchplate.search.jde import Jde
from torchplate.search.l_shade import LShade
from torchplate.search.least_squares import least_squares
from torchplate.search.least_squares_outcome import LeastSquaresOutcome, LeastSquaresProgress, LeastSquaresStatus
from torchplate.search.many_starts import LeastSquares, least_squares_from_many_starts
from torchplate.search.minimization import Objective, minimize
from torchplate.search.optimizer import OPTIMIZERS, Candidates, Optimizer, State, optimizer_named, unknown_name
from torchplate.search.outcome import Checkpoint, Outcome, Progress, Status
from torchplate.search.recall import Descent, Recall, recalled, recalling
from torchplate.search.sade import Sade
from torchplate.search.sharded import RankLost, RanksDiffer, ShardedObjective, ShardingError

__all__ = [
    "BOUNDS",
    "JACOBIANS",
    "OPTIMIZERS",
    "STRATEGIES",
    "ArtificialBeeColony",
    "Candidates",
    "Checkpoint",
    "Descent",
    "DifferentialEvolution",
    "Jde",
    "LShade",
    "LeastSquares",
    "LeastSquaresOutcome",
    "LeastSquaresProgress",
    "LeastSquaresStatus",
    "Objective",
    "Optimizer",
    "Outcome",
    "Progress",
    "RankLost",
    "RanksDiffer",
    "Recall",
    "Residual",
    "Sade",
    "ShardedObjective",
    "ShardingError",
    "State",
    "Status",
    "least_squares",
    "least_squares_from_many_starts",
    "minimize",
    "optimizer_named",
    "recalled",
    "recalling",
    "unknown_name",
]
