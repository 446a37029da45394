"""The verbs of the command line, in the order in which `torchplate --help` lists them.

What a verb alone needs is imported when it is called, or asked for its help: `torchplate --help` waits for no torch.
"""

from typing import Final

from torchplate.cli.file_verbs import FILE_VERBS
from torchplate.cli.run_verbs import RUN_VERBS
from torchplate.cli.telling_verbs import TELLING_VERBS

VERBS: Final = FILE_VERBS | RUN_VERBS | TELLING_VERBS
