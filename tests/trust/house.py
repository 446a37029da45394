"""Seconds of the processor that the house itself takes: to import the package, and to say what it can do.

    python tests/trust/house.py --write

Each is started five times and the quickest counts: the first reads files from the disk, and others on the machine
make the rest slower, never quicker.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

# It is run as a script, beside which its neighbour lies; where tests are collected, that is on no path.
sys.path.insert(0, str(Path(__file__).parent))
import figures

os.environ.setdefault("OMP_NUM_THREADS", "1")

# What is started, and the seconds of the processor that it may take.
HOUSE: dict[str, tuple[list[str], float | None]] = {
    "import torchplate": (["-c", "import torchplate"], 1.5),
    "the same with what a script needs, torch too": (
        ["-c", "import torchplate as tp; tp.load_model, tp.read_measurement, tp.minimize"],
        None,
    ),
    "torchplate --help": (["-m", "torchplate", "--help"], 1.0),
}


def seconds(words: list[str]) -> float:
    """Of the processor, that Python takes for these words, its own start included."""
    started = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL)
    # Of this process alone, in microseconds: `os.times` counts ticks of ten milliseconds, of all that have ended.
    _, ended, used = os.wait4(started.pid, 0)
    started.returncode = os.waitstatus_to_exitcode(ended)
    if started.returncode:
        raise RuntimeError(f"Expected {' '.join(words)} to end with 0, got {started.returncode}.")
    return used.ru_utime + used.ru_stime


def main(arguments: list[str] | None = None) -> int:
    """Start, time and print; 1 if one takes longer than it may."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=5, help="each is started (default: 5)")
    parser.add_argument("--write", action="store_true", help="put the figures onto docs/verification.md")
    given = parser.parse_args(arguments)
    told, late = [], False
    for name, (words, allowed) in HOUSE.items():
        taken = min(seconds(words) for _ in range(given.times))
        told.append(f"`{name}` {taken:.2f} s" + (f" of {allowed:g} s" if allowed else ""))
        late = late or (allowed is not None and taken > allowed)
    print("; ".join(told))
    if given.write:
        figures.put("seconds of the processor", "tests/trust/house.py", "; ".join(told))
    return int(late)


if __name__ == "__main__":
    sys.exit(main())
