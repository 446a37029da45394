"""`make run`: a virtual modal test and the paper's measured natural frequencies, each identified by DE and by ABC.

The two searches of a problem know nothing of each other and run side by side, the second in a process of its own.
"""

import subprocess
import sys
import time
from pathlib import Path

from rich.console import Console

from torchplate.cli.config import InputError
from torchplate.cli.verbs.compare import compare
from torchplate.cli.verbs.run import run
from torchplate.cli.verbs.simulate import simulate
from torchplate.measurement import MeasurementError

CONFIGS = Path("configs")
RUNS = Path("runs")
DE, ABC = "differential_evolution", "artificial_bee_colony"
# A colony of 32 bees: 16 food sources, so that a cycle costs as many evaluations as a generation of 32 members.
BEES = "search={optimizer: artificial_bee_colony, n_member: 16, n_generation: 100, seed: 0}"


def main() -> int:
    """Do it all; returns the exit status."""
    console = Console()
    began = time.monotonic()
    try:
        simulate(CONFIGS / "virtual_plate.yaml", RUNS / "steel_plate" / "virtual_test.uff", console=console, force=True)
        for name in ("steel_plate", "measured_frequencies"):
            config = CONFIGS / f"{name}.yaml"
            folders = [RUNS / name / DE, RUNS / name / ABC]
            command = [sys.executable, "-m", "torchplate", "run", str(config), "--out", str(folders[1]), "--force"]
            with subprocess.Popen([*command, "--set", BEES], stdout=subprocess.PIPE, text=True) as colony:
                console.rule(f"{name}: {DE}")
                run(config, folders[0], console=console, force=True)
                console.rule(f"{name}: {ABC}, which ran beside it")
                console.print(colony.communicate()[0], end="", markup=False, highlight=False, soft_wrap=True)
            if colony.returncode:
                return colony.returncode  # its own process has said why
            console.rule(f"{name}: side by side")
            compare(folders, console=console, force=True)
    except (InputError, MeasurementError) as error:
        print(error, file=sys.stderr)
        return 2
    console.print(
        f"Done in {time.monotonic() - began:.0f} s. Results lie in {RUNS}/steel_plate and {RUNS}/measured_frequencies; "
        f"DE over ABC: .venv/bin/tensorboard --logdir {RUNS}",
        soft_wrap=True,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
