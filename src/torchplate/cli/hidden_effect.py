"""`make diagnose`: a virtual hammer test of a plate that carries something nobody wrote down, and its diagnosis."""

import shutil
import sys
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.diagnose import diagnose
from torchplate.cli.simulate import simulate
from torchplate.measurement import MeasurementError

CONFIGS = Path("configs")
FOLDER = Path("runs/hidden_effect")
PICTURES = Path("runs/examples")


def main() -> int:
    """Do it; returns the exit status."""
    console = Console()
    try:
        simulate(CONFIGS / "hidden_effect_truth.yaml", FOLDER / "virtual_test.uff", console=console)
        diagnose(CONFIGS / "hidden_effect.yaml", FOLDER / "diagnosis", console=console, force=True)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    for picture in ("gap", "map"):
        shutil.copy(FOLDER / "diagnosis" / "figures" / f"{picture}.png", PICTURES / f"hidden_effect_{picture}.png")
    console.print(f"Open {FOLDER}/diagnosis/report.html", soft_wrap=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
