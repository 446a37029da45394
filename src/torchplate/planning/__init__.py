"""The next test: which of those that a lab can do would tell the names apart that a diagnosis leaves open.

- `plan`: the steps; `result`: what it ends with.
- `lab`: what can be done, and every test that follows from it; `proposal`: one of these tests.
- `bench`: a hypothesis in a basis that serves all of them; `forthcoming`: what each would give.
- `gain`: what it is expected to say of the names; `refit`: the same where nothing is taken for linear.
"""

from torchplate.planning.lab import Lab
from torchplate.planning.plan import plan
from torchplate.planning.proposal import KINDS
from torchplate.planning.result import Plan

__all__ = [
    "KINDS",
    "Lab",
    "Plan",
    "plan",
]
