"""What each verb of the command line takes, an example of it, and what it calls.

- `verb`: what a verb is to the parser.
- `file_verbs`: those that take what was measured; `run_verbs`: a config, or the runs of one; `telling_verbs`: nothing.

`VERBS` holds all, in the order in which `torchplate --help` lists them. What a verb alone needs is imported when it is
called, or asked for its help: `torchplate --help` waits for no torch.
"""

from typing import Final

from torchplate.cli.arguments.file_verbs import FILE_VERBS
from torchplate.cli.arguments.run_verbs import RUN_VERBS
from torchplate.cli.arguments.telling_verbs import TELLING_VERBS

__all__ = ["VERBS"]

VERBS: Final = FILE_VERBS | RUN_VERBS | TELLING_VERBS
