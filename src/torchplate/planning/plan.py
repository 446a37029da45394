"""The cheapest further test that would tell which of the names is right, among those that a lab can do."""

import math
import time
from collections.abc import Callable, Mapping, Sequence

import torch

from torchplate.diagnosis import SETTINGS, DiagnosisSettings, Doubt, ForwardSelection, FrfTarget, one_thread
from torchplate.measurement import Imperfections, Measurement, noise_level
from torchplate.model import PlateModel
from torchplate.planning.bench import Bench
from torchplate.planning.forthcoming import Forthcoming
from torchplate.planning.gain import Gain, expected_gain, narrowed
from torchplate.planning.lab import Lab
from torchplate.planning.proposal import NoWindow
from torchplate.planning.refit import refitted
from torchplate.planning.result import SURE, Plan, Scored

# Tests that are looked at again without taking anything for linear, at most.
N_CONFIRMED = 4
# Draws of what noise does to a log likelihood ratio.
N_DRAW = 2000


@one_thread()
@torch.no_grad()
def plan(
    model: PlateModel,
    measurement: Measurement,
    doubts: Sequence[Doubt],
    *,
    lab: Lab | None = None,
    tolerance: Mapping[str, float] | None = None,
    n_average: int | None = None,
    gain_is_unknown: bool = False,
    imperfections: Imperfections | None = None,
    seed: int = 0,
    settings: DiagnosisSettings = SETTINGS,
    say: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Score every test that a lab can do by what it is expected to say of the name that is least sure.

    Args:
        model: the given one, as it was diagnosed.
        measurement: FRFs, as they were diagnosed.
        doubts: what the diagnosis left open.
        lab: what can be done; everything, where it is left out.
        tolerance: how well numbers are known: "label.parameter", "mesh.length_x" → standard deviation in SI units.
        n_average: records behind each FRF, where known.
        gain_is_unknown: the level of the FRFs carries no unit.
        imperfections: what a test is not perfect in.
        seed: of the draws.
        settings: of the diagnosis.
        say: is told what is being scored.

    Raises:
        ValueError: if there is nothing to plan for, or nothing that the lab can do.
    """
    began = time.monotonic()
    if not doubts:
        raise ValueError("Expected a diagnosis of FRFs, got none that left hypotheses. Diagnose FRFs first.")
    lab, imperfections = lab or Lab(), imperfections or Imperfections()
    doubt = min(doubts, key=lambda one: max(one.probability.values()))
    noise = noise_level(measurement, n_average)
    nothing = torch.zeros_like(measurement.measured)
    target = FrfTarget(measurement, noise, nothing, gain_is_unknown, imperfections, settings)
    builder = ForwardSelection.of(model, target, dict(tolerance or {}), say).builder
    windows = any(effect.name == "exponential_window" for one in doubt.rivals for effect in one.effects.values())
    proposals = [one for one in lab.proposals(model, imperfections) if windows or not isinstance(one, NoWindow)]
    if not proposals:
        raise ValueError("Expected a test that the lab can do, got none for this plate. Allow more by --can.")
    places = [point for one in proposals for point in (*one.places, *(one.response or ()), *(one.reference or ()))]
    benches = [Bench(builder, rival, list(dict.fromkeys(places))) for rival in doubt.rivals]
    names = [one.name for one in doubt.rivals]
    say(f"{len(proposals)} tests, {len(benches)} hypotheses: {', '.join(dict.fromkeys(names)) or 'nothing missing'}")
    scored = []
    for proposal in proposals:
        one = _scored(Forthcoming(benches, builder.target, doubt, proposal), doubt, seed)
        scored.append(one)
        say(f"  {proposal.title}: {one.probability:.3f}, {one.gain.bits:.2f} bit")
    needed = max(doubt.probability.values()) < SURE
    found = Plan(doubt, needed, tuple(sorted(scored, key=_rank if needed else lambda one: one.narrowing)))
    if needed:
        found = _confirmed(found, benches, builder.target, say)
    return found.after(time.monotonic() - began)


def _scored(test: Forthcoming, doubt: Doubt, seed: int) -> Scored:
    predicted = [test.predicted(k) for k in range(len(test.benches))]
    rivals = doubt.rivals
    gain = expected_gain([one.name for one in rivals], [one.probability for one in rivals], predicted, seed)
    best = next(k for k, one in enumerate(rivals) if one.label == doubt.label)
    ratio = narrowed(test.benches[best].model.names, test.benches[best].axes, predicted[best])
    whole = Gain(gain.probability, gain.bits, gain.said, ratio)
    assert test.proposal is not None
    return Scored(test.proposal, whole)


def _rank(one: Scored) -> tuple[float, float]:
    """The cheapest that tells first, then what tells most; of those that tell as much, as they were proposed."""
    return (float(one.proposal.cost) if one.probability >= SURE else math.inf, -round(one.probability, 2))


def _confirmed(found: Plan, benches: Sequence[Bench], target: FrfTarget, say: Callable[[str], None]) -> Plan:
    """The plan with its first tests looked at again, until one is confirmed to tell."""
    scored = list(found.scored)
    for _ in range(min(N_CONFIRMED, len(scored))):
        first = min(scored, key=_rank)
        if first.confirmed is not None:
            break
        test = Forthcoming(benches, target, found.doubt, first.proposal)
        value = confirmed(
            test, [one.probability for one in found.doubt.rivals], [one.name for one in found.doubt.rivals]
        )
        say(f"  {first.proposal.title}: {value:.3f} where every hypothesis is refitted to what each other one predicts")
        scored[scored.index(first)] = Scored(first.proposal, first.gain, value)
    return Plan(found.doubt, found.needed, tuple(sorted(scored, key=_rank)))


def confirmed(test: Forthcoming, prior: Sequence[float], names: Sequence[str]) -> float:
    """Expected probability of the right name, every hypothesis refitted to what each other one predicts.

    Between hypotheses that are D apart in −2 ln Z, noise makes the log likelihood ratio normal about D/2 with variance
    D.

    Args:
        test: to be made.
        prior: probabilities of the hypotheses.
        names: of them.
    """
    n = len(prior)
    apart = torch.zeros(n, n, dtype=torch.float64)
    for i in range(n):
        measured = test.says(i, test.benches[i].here)
        row = torch.tensor([refitted(test, j, measured).evidence for j in range(n)], dtype=torch.float64)
        apart[i] = row - row[i]
    generator = torch.Generator().manual_seed(0)
    normal = torch.randn(N_DRAW, n, generator=generator, dtype=torch.float64)
    p = torch.tensor(prior, dtype=torch.float64)
    p = p / p.sum()
    right = 0.0
    for i in range(n):
        spread = apart[i].clamp(min=0.0).sqrt()
        odds = (p.log() - 0.5 * apart[i] - spread * normal).softmax(-1)
        own = torch.tensor([name == names[i] for name in names])
        right += float(p[i]) * float(odds[:, own].sum(-1).mean())
    return right
