"""The stratum of states: 40 pairs of tests of one plate, 10 of them unchanged, under the workshop's nuisances.

What a plate and its sensors are not perfect in is drawn once a pair: wander, grain, damping of each mode, sides,
numbers, accelerometers, gains. Places of hits, the drift of the records and the noise are drawn anew for each test.
Each pair is diagnosed by `torchplate diagnose config.yaml --since reference.yaml`.

| change | n | size |
|---|---|---|
| none | 10 | |
| point_mass came | 6 | 0.005 to 0.03 M, log |
| lump.mass: a known mass of 0.005 to 0.03 M came off | 3 | all of it |
| wires.stiffness | 5 | 0.4 to 0.75 of it, or its inverse |
| wires.viscous_damping | 2 | 0.4 to 0.6 of it, or its inverse |
| loss.stiffness_loss_factor | 3 | likewise |
| stiffness_loss | 4 | as in `effects` |
| ground_spring | 3 | as in `effects` |
| ground_dashpot | 2 | as in `effects` |
| damping_patch | 2 | as in `effects` |
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
import yaml

from blind import noise
from blind.cases import NOISE, Case, Slot, as_measurement, known, seed_of
from blind.effects import Hidden, Truth, apply, draw_hidden
from blind.nuisances import WORKSHOP, Drawn, _moved, spoil
from blind.plates import ALUMINIUM, STEEL, Rng, draw_specimen, log_uniform
from blind.score import coverage, read, wilson
from blind.workshop import _config, with_all, with_layout
from torchplate.measurement import Measurement, write_uff

CHANGES = {
    "point_mass": 6, "lump.mass": 3, "wires.stiffness": 5, "wires.viscous_damping": 2, "loss.stiffness_loss_factor": 3,
    "stiffness_loss": 4, "ground_spring": 3, "ground_dashpot": 2, "damping_patch": 2,
}  # fmt: skip
N_UNCHANGED = 10
MASS = (0.005, 0.03)
# What may stand beside a true name: no data of these part them, or hardly.
TWINS = {
    "wires.stiffness": {"support_asymmetry", "ground_spring"},
    "wires.viscous_damping": {"ground_dashpot", "viscous_damping"},
    "loss.stiffness_loss_factor": {"viscous_damping", "hysteretic_damping", "directional_damping"},
    "lump.mass": {"point_mass"},
    "point_mass": {"absorber", "lump.mass"},
    "ground_spring": {"support_spring", "support_asymmetry"},
    "ground_dashpot": {"support_spring", "wires.viscous_damping"},
}


@cache
def suite() -> tuple[Slot, ...]:
    """All slots, mixed."""
    slots = [Slot("unchanged", (), turn) for turn in range(N_UNCHANGED)]
    slots += [Slot("changed", (name,), turn) for name, n in CHANGES.items() for turn in range(n)]
    order = np.random.default_rng(40).permutation(len(slots))
    return tuple(slots[index] for index in order)


@dataclass(frozen=True)
class Pair(Case):
    """A case, and the reference test before it."""

    reference: dict[str, Any] = field(default_factory=dict)
    before: Measurement | None = None

    def write(self, folder: Path) -> Path:
        """Write both tests and both configs; of the truth they say nothing."""
        path = super().write(folder)
        assert self.before is not None
        write_uff(self.before, folder / "before.uff", binary=True)
        (folder / "reference.yaml").write_text(
            yaml.safe_dump(self.reference, sort_keys=False, default_flow_style=None, width=120)
        )
        return path


def draw(seed_set: str, index: int, by: str | None = None) -> Pair:
    """One pair: the same for ever for a seed set and an index from 0 to 39.

    Args:
        seed_set: any word.
        index: from 0 to 39.
        by: which truth; left out, Ritz's.
    """
    slot, rng = suite()[index], np.random.default_rng([*seed_of(seed_set, index), 18])
    kind = STEEL if rng.random() < 0.5 else ALUMINIUM
    level = log_uniform(rng, *NOISE)
    specimen = draw_specimen(rng, kind, False, frozenset(slot.names))
    specimen = replace(specimen, plate=replace(specimen.plate, by=by or "ritz"))
    specimen = with_layout(rng, specimen, at_least=3)
    drawn = spoil(rng, specimen, WORKSHOP, frozenset(), slip=False)
    shape = str(rng.choice(noise.SHAPES))
    settings = _config(drawn, specimen, "measurement.uff", True, None, index)
    plate = drawn.specimen.plate
    lump: tuple[float, float, float] | None = None
    if slot.names == ("lump.mass",):
        x, y = (float(v) for v in rng.uniform(0.06, 0.94, 2))
        lump = (x, y, plate.mass * log_uniform(rng, *MASS))
        settings["effects"]["lump"] = {"effect": "point_mass", "x": x, "y": y, "mass": float(f"{lump[2]:.4g}")}
    hidden = _hidden(rng, slot, drawn, lump)
    read, averages = [], []
    for truth in (_truth(drawn, None, lump), _truth(_anew(rng, drawn, specimen.test.reference), hidden, lump)):
        spoilt, _, coherence, n_average = noise.spoil(rng, truth.frf(), truth.test, level, shape)
        told = None if coherence is None else torch.from_numpy(coherence)
        read.append(as_measurement(specimen, spoilt, told, True))
        averages.append({} if n_average is None else {"n_average": n_average})
    configs = [
        settings | {"measurement": settings["measurement"] | {"file": file} | more}
        for file, more in zip(("before.uff", "measurement.uff"), averages, strict=True)
    ]
    return Pair(
        name=f"{index:03d}", kind=slot.kind, config=configs[1], measurement=read[1],
        truth=[] if hidden is None else [hidden], noise=level, shows=(), youngs_modulus=plate.young,
        young_is_seen=not known(settings), sides=kind.sides, file="measurement.uff", specimen=drawn.specimen,
        extra={"noise_" + shape: 1.0}, stratum="states", reference=configs[0], before=read[0],
    )  # fmt: skip


def _anew(rng: Rng, drawn: Drawn, marks: Sequence[tuple[float, float]]) -> Drawn:
    """The same plate and sensors, hit again on another day: at the marks, each hit off its own way."""
    test = drawn.specimen.test
    again = replace(test, reference=_moved(rng, marks, WORKSHOP.position, drawn.specimen.plate.sides))
    chain = replace(drawn.chain, drift=WORKSHOP.drift * rng.standard_normal(len(test.reference)))
    return replace(drawn, specimen=replace(drawn.specimen, test=again), chain=chain)


def _hidden(rng: Rng, slot: Slot, drawn: Drawn, lump: tuple[float, float, float] | None) -> Hidden | None:
    """What has changed; parameters that moved hold their value after."""
    if not slot.names:
        return None
    name, specimen = slot.names[0], drawn.specimen
    sign = 1 if rng.random() < 0.5 else -1
    if name == "lump.mass":
        assert lump is not None
        return Hidden(name, {}, {"mass": 0.0})
    if name == "wires.stiffness":
        return Hidden(name, {}, {"stiffness": specimen.stiffness * float(rng.uniform(0.4, 0.75)) ** sign})
    if name == "wires.viscous_damping":
        return Hidden(name, {}, {"viscous_damping": specimen.viscous * float(rng.uniform(0.4, 0.6)) ** sign})
    if name == "loss.stiffness_loss_factor":
        beta = specimen.damping.beta * float(rng.uniform(0.4, 0.6)) ** sign
        return Hidden(name, {}, {"stiffness_loss_factor": beta})
    one = draw_hidden(rng, name, specimen, slot.turn)
    if name == "point_mass":
        one = replace(one, parameters=one.parameters | {"mass": specimen.plate.mass * log_uniform(rng, *MASS)})
    return one


def _truth(drawn: Drawn, hidden: Hidden | None, lump: tuple[float, float, float] | None) -> Truth:
    """The plate of one test."""
    truth = with_all(drawn, [], loss=True)
    plate = truth.plate
    if lump is not None and (hidden is None or hidden.effect != "lump.mass"):
        truth = replace(truth, plate=replace(plate, masses=[*plate.masses, lump]))
    if hidden is None or hidden.effect == "lump.mass":
        return truth
    p = hidden.parameters
    if hidden.effect == "wires.stiffness":
        springs = [(x, y, p["stiffness"]) for x, y, _ in plate.springs]
        return replace(truth, plate=replace(plate, springs=springs))
    if hidden.effect == "wires.viscous_damping":
        dashpots = [(x, y, p["viscous_damping"]) for x, y, _ in plate.dashpots]
        return replace(truth, plate=replace(plate, dashpots=dashpots))
    if hidden.effect == "loss.stiffness_loss_factor":
        return replace(truth, damping=replace(truth.damping, beta=p["stiffness_loss_factor"]))
    return apply(truth, drawn.specimen, hidden)


def judged(record: dict[str, Any]) -> tuple[bool, bool]:
    """Whether changed or unchanged is right, and whether the name is; an unchanged pair has no name to get right.

    What is said of a pair is its verdict: `consistent` says that nothing changed, any other that something did, with a
    name or without one.
    """
    hidden = [one["effect"] for one in record["truth"]["hidden"]]
    found = record["diagnosis"]
    answers = [] if found is None else [one for one in found["effects"] if one["name"] != "mesh_discretisation"]
    right = found is not None and (found["verdict"] != "consistent") == bool(hidden)
    if not hidden or len(answers) != 1:
        return right, right and not hidden
    names = {answers[0]["name"], *answers[0]["equivalent"]}
    return right, hidden[0] in names and names <= {hidden[0], *TWINS.get(hidden[0], set())}


def rates(records: Sequence[dict[str, Any]]) -> list[tuple[str, int, int]]:
    """What is counted: how many, and of how many."""
    told = [(one, *judged(one)) for one in records]
    changed = [pair for pair in told if pair[0]["truth"]["hidden"]]
    unchanged = [pair for pair in told if not pair[0]["truth"]["hidden"]]
    named = sum(bool(one["diagnosis"] and one["diagnosis"]["effects"]) for one, *_ in unchanged)
    inside = [
        held
        for one, _, name in changed
        if name and one["diagnosis"]["effects"][0]["name"] == one["truth"]["hidden"][0]["effect"]
        for _, held in coverage(one["truth"]["hidden"][0], one["diagnosis"]["effects"][0])
    ]
    return [
        ("changed or unchanged, right", sum(right for _, right, _ in told), len(told)),
        ("named right, of those that changed", sum(name for *_, name in changed), len(changed)),
        ("a false name on an unchanged plate", named, len(unchanged)),
        ("90 % intervals of right names hold the truth", sum(inside), len(inside)),
        ("crashes", sum(one["diagnosis"] is None for one in records), len(records)),
    ]


def report(folder: Path) -> None:
    """Print how many were right, with Wilson's 90 % intervals, and what was wrong; and write it to table.md there."""
    records, rows = read(folder / "results.jsonl"), []
    for title, count, n in rates(records):
        low, high = wilson(count, n)
        print(f"{title}: {count} of {n}, {count / max(n, 1):.2f} ({low:.2f} to {high:.2f})")
        each = f"{100 * count / max(n, 1):.0f} % | {100 * low:.0f} to {100 * high:.0f} %"
        rows.append(f"| {title} | {count} | {n} | {each} |")
    wrong = [line(record) for record in records if not all(judged(record))]
    print("\n".join(wrong))
    spent = [record["seconds_of_cpu"] for record in records if "seconds_of_cpu" in record]
    cost = f"Seconds of CPU: {median(spent):.0f} in the middle, {max(spent):.0f} at worst.\n\n" if spent else ""
    head = f"### states: rates\n\n{cost}| what | n | of | rate | 90 % interval |\n| --- | --- | --- | --- | --- |\n"
    told = "\n### what was wrong\n\n" + "".join(f"- {one}\n" for one in wrong or ["nothing"])
    (folder / "table.md").write_text(head + "\n".join(rows) + "\n" + told)


def line(record: dict[str, Any]) -> str:
    """One pair in one line."""
    right, named = judged(record)
    hidden = [one["effect"] for one in record["truth"]["hidden"]]
    found = record["diagnosis"]
    said = (
        record.get("error", "")
        if found is None
        else " + ".join("/".join([one["name"], *one["equivalent"]]) for one in found["effects"]) or found["verdict"]
    )
    mark = "right" if right and named else "changed right, name wrong" if right else "wrong"
    return (
        f"{record['truth']['name']} {mark}: {hidden[0] if hidden else 'nothing'} -> {said} ({record['seconds']:.0f} s)"
    )
