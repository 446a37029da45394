"""How often one name is left after the test that `plan` proposes: `python -m tests.planning.closed_loop --cases 12`.

Each case is a pair of effects that explain a first test alike, of another size each time. What is true is drawn, with
the plate's parameters as probable as the first test leaves them; the proposed test of it is simulated with a noise of
its own; and the names are weighed once more, each hypothesis refitted. Right is a case with more than 0.95 on the true
name.
"""

import argparse

import torch
from tests.planning.conftest import COARSE, PAIRS, TOLD, Twins, measured

from torchplate.planning import Lab, plan
from torchplate.planning.forthcoming import Forthcoming
from torchplate.planning.refit import posterior, refitted


@torch.no_grad()
def one_case(seed: int) -> tuple[str, str, str, float, float]:
    """Pair, true name, test, and the probability of the true name: as it was expected, and as it came."""
    generator = torch.Generator().manual_seed(seed)
    pair = PAIRS[seed % len(PAIRS)]
    size = 0.4 + 1.2 * float(torch.rand(1, generator=generator))
    twins = Twins(pair, seed, size)
    lab = Lab(n_place=2, shares=(0.03,))
    found = plan(twins.model, twins.measurement, [twins.doubt], lab=lab, imperfections=TOLD, settings=COARSE)
    proposal, rivals = found.proposed.proposal, twins.doubt.rivals
    test = Forthcoming(twins.bench(proposal), twins.target, twins.doubt, proposal)
    true = int(torch.randint(len(rivals), (1,), generator=generator))
    bench = test.benches[true]
    off = bench.axes @ torch.randn(len(bench.here), generator=generator, dtype=torch.float64)
    frf = test.says(true, (bench.here + off).clamp(0.0, 1.0))
    read = measured(frf, 1000 + seed, twins.model.kind, twins.lines).frf
    evidence = [refitted(test, k, read).evidence for k in range(len(rivals))]
    names = [one.name for one in rivals]
    after = posterior(names, [one.probability for one in rivals], evidence)
    return pair, names[true], proposal.title, found.proposed.probability, after[names[true]]


def main() -> None:
    """All cases, a line each, and how many are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    asked = parser.parse_args()
    right = 0
    for seed in range(asked.first, asked.first + asked.cases):
        pair, name, title, expected, came = one_case(seed)
        right += came > 0.95
        print(f"{seed:4d} {pair:8s} {name:20s} {title:34s} expected {expected:.3f} came {came:.3f}", flush=True)
    print(f"one name in {right} of {asked.cases}")


if __name__ == "__main__":
    main()
