"""`python tests/blind --set A --out runs/blind/A --workers 2 [--cases 0:20] [--only point_mass] [--draw | --score]`."""

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1]))


def main() -> None:
    """Draw, run, score."""
    from blind import states
    from blind.score import report
    from blind.strata import STRATA, TRUTHS
    from blind.suite import chosen, print_draws, run_suite

    parser = argparse.ArgumentParser(
        prog="python tests/blind", description="The blind benchmark of torchplate diagnose."
    )
    parser.add_argument("--set", dest="seed_set", default="A", help="seed set: A and B were seen in tuning, C was not")
    parser.add_argument("--stratum", choices=STRATA, default="clean", help="what the cases are like; see the map")
    parser.add_argument("--truth", choices=TRUTHS, help="which discretisation makes the truth (clean: ritz, else both)")
    parser.add_argument("--out", type=Path, help="folder of cases, results.jsonl, table.md (runs/blind/[STRATUM/]SET)")
    parser.add_argument("--workers", type=int, default=2, help="processes, one thread each")
    parser.add_argument("--cases", default="0:", help="a slice 0:20 or a list 3,17")
    parser.add_argument("--only", help="cases that hide this effect, or of a kind: none, one, two, beyond")
    parser.add_argument("--draw", action="store_true", help="print what the cases are, run nothing")
    parser.add_argument("--score", action="store_true", help="score what is there, run nothing")
    given = parser.parse_args()
    home = Path("runs/blind") if given.stratum == "clean" else Path("runs/blind") / given.stratum
    out: Path = given.out or home / given.seed_set
    indices = chosen(given.cases, given.only, given.stratum)
    if given.draw:
        print_draws(given.seed_set, indices, given.stratum, given.truth)
        return
    if not given.score:
        run_suite(given.seed_set, indices, out, given.workers, stratum=given.stratum, by=given.truth)
    if not (out / "results.jsonl").is_file():
        sys.exit(f"{out}: Expected a results.jsonl, found none. Run the cases first.")
    (states.report if given.stratum == "states" else report)(out)


if __name__ == "__main__":
    main()
