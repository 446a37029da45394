"""`python -m torchplate`, the same as the command `torchplate`."""

import sys

from torchplate.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
