"""How fast, beside what else there is: every figure of speed that the README quotes.

- `problem`: the paper's plate, its members and lines.
- `peer`: the same as a script with NumPy and SciPy makes it, one candidate at a time.
- `timing`: medians of ways that take turns, threads, memory, and what the machine can do.
- `generation`: one generation of the paper's problem.
- `identification`: the paper's whole identification.
- `gradient`: what a gradient costs, in evaluations.
- `slopes`: cost against mesh, members, lines and FRFs.
- `scaling`: what a second process brings.
- `verification`: not how fast but how right: every figure of the verification page.
- `published`: natural frequencies that it is held against.
- `searches`: evaluations beside SciPy, pymoo and pagmo.

Each part is run in a process of its own, by `torchplate bench`, so that the number of threads is what it says.
"""

from torchplate.bench.generation import generation, memory
from torchplate.bench.gradient import gradient
from torchplate.bench.identification import identification
from torchplate.bench.slopes import slopes

__all__ = [
    "generation",
    "gradient",
    "identification",
    "memory",
    "slopes",
]
