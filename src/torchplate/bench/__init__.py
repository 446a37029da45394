"""How fast, beside what else there is: every figure of speed that the README quotes.

- `problem`: the paper's plate, its members and lines.
- `peer`: the same as a script with NumPy and SciPy makes it, one candidate at a time.
- `timing`: medians of ways that take turns, threads, memory, and what the machine can do.
- `generation`: one generation of the paper's problem.
- `identification`: the paper's whole identification.
- `gradient`: what a gradient costs, in evaluations.
- `slopes`: cost against mesh, members, lines and FRFs.
- `air`: what the air around a plate costs.
- `scaling`: what a second process brings.
- `verification`: not how fast but how right: every figure of the verification page.
- `marked_page`: where the tables of that page stand.
- `recorded`: rows of that page from blind sets and times as they were written last.
- `published`: natural frequencies that it is held against.
- `searches`: evaluations and seconds beside SciPy, pymoo, pagmo and evosax.

Each part is run in a process of its own, by `torchplate bench`, so that the number of threads is what it says.
"""

from torchplate.bench.air import air
from torchplate.bench.generation import generation, memory
from torchplate.bench.gradient import gradient
from torchplate.bench.identification import identification
from torchplate.bench.marked_page import PAGE, between, commit, put
from torchplate.bench.problem import KNOWN, LINES, SEARCHED, TRUTH, members, paper_model
from torchplate.bench.slopes import slopes
from torchplate.bench.timing import peak_memory

__all__ = [
    "KNOWN",
    "LINES",
    "PAGE",
    "SEARCHED",
    "TRUTH",
    "air",
    "between",
    "commit",
    "generation",
    "gradient",
    "identification",
    "members",
    "memory",
    "paper_model",
    "peak_memory",
    "put",
    "slopes",
]
