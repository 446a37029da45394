"""What has changed between two tests of one plate.

- `flow`: the steps; `settings`: what is taken for granted, with its reasons.
- `specimen`: a plate each of whose modes is off by its own number; `reference`: what the first test says of it.
- `changes`: what may have changed; `hypothesis`: a model with that in it, beside what the reference leaves open;
  `settling`: channels and drift that are most probable beside it; `after`: fits of it to the second test.
- `comparison`: all of it, tried and refitted; `posterior`: which of it is most probable; `summary`: what is said.
- `table`: the same of two tables of natural frequencies; `table_fit`: one change fitted to them; `together`: several of
  one kind; `table_summary`: what is said of these.
"""

from torchplate.diagnosis.change.flow import PlateTest, what_changed

__all__ = ["PlateTest", "what_changed"]
