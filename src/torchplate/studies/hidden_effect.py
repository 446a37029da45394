"""`make diagnose`: a virtual hammer test of a plate that carries something nobody wrote down, and its diagnosis.

Everything goes to `runs/hidden_effect`. README's pictures are written anew only where `--pictures runs/examples` asks.
"""

import argparse
import shutil
import sys
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.verbs.diagnose import diagnose
from torchplate.cli.verbs.simulate import simulate
from torchplate.measurement import MeasurementError

CONFIGS = Path("configs")
FOLDER = Path("runs/hidden_effect")


def main(pictures: Path | None = None) -> int:
    """Do it; returns the exit status.

    Args:
        pictures: a folder that the figures of gap and map are copied into, too.
    """
    console = Console()
    try:
        simulate(CONFIGS / "hidden_effect_truth.yaml", FOLDER / "virtual_test.uff", console=console, force=True)
        diagnose(CONFIGS / "hidden_effect.yaml", FOLDER / "diagnosis", console=console, force=True)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        for name in ("gap", "map"):
            shutil.copy(FOLDER / "diagnosis" / "figures" / f"{name}.png", pictures / f"hidden_effect_{name}.png")
    console.print(f"Open {FOLDER}/diagnosis/report.html", soft_wrap=True)
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Find what is hidden on a plate that was hit in a virtual test.")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="copy the figures of gap and map there, too")
    sys.exit(main(parser.parse_args().pictures))
