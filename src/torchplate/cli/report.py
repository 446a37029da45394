"""`report.md` of a run, and the figures in it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from matplotlib.figure import Figure
from torch import Tensor

from torchplate.cli.build import Run
from torchplate.cli.figures import NOMINAL, UPDATED, Curve, frf_overlay, natural_frequencies, save
from torchplate.cli.writing import write_text
from torchplate.discrepancy import Objective
from torchplate.identification import CORRELATED, Result, nominal


@torch.no_grad()
def frf_figures(objective: Objective, theta: Tensor, n_panel: int) -> dict[str, Figure]:
    """One overlay for each shown FRF: measured, nominal, updated; by its TensorBoard tag."""
    measurement = objective.evidence.measurement
    if measurement is None:
        return {}
    return {
        f"frf/{title.replace('/', '_')}": _overlay(objective, theta, [(j, k, title)])
        for j, k, title in _shown(objective, n_panel)
    }


@torch.no_grad()
def figures(objective: Objective, theta: Tensor, n_panel: int) -> dict[str, Figure]:
    """The report's figures, by file name."""
    drawn = {}
    if objective.evidence.measurement is not None:
        drawn["frf"] = _overlay(objective, theta, _shown(objective, n_panel))
    if (table := objective.evidence.natural_frequencies) is not None:
        models = {"nominal": nominal(objective), "updated": theta} if objective.model.names else {"model": theta}
        found = {label: objective.natural_frequencies(member).tolist() for label, member in models.items()}
        drawn["natural_frequencies"] = natural_frequencies(table.mode.tolist(), table.frequency.tolist(), found)
    return drawn


def _shown(objective: Objective, n_panel: int) -> list[tuple[int, int, str]]:
    """Indices and titles of the FRFs that are drawn, spread over all of them."""
    measurement = objective.evidence.measurement
    assert measurement is not None
    pairs = measurement.pairs
    chosen = torch.linspace(0, len(pairs) - 1, min(n_panel, len(pairs))).round().long().tolist()
    return [(*pairs[index], measurement.pair_label(*pairs[index])) for index in chosen]


def _overlay(objective: Objective, theta: Tensor, pairs: Sequence[tuple[int, int, str]]) -> Figure:
    measurement = objective.evidence.measurement
    assert measurement is not None
    curves = []
    if objective.model.names:
        curves.append(Curve("nominal", objective.frf(nominal(objective)), NOMINAL, 1.0))
    curves.append(Curve("updated" if objective.model.names else "model", objective.frf(theta), UPDATED))
    return frf_overlay(measurement.frequency, measurement.frf, curves, pairs, measurement.kind)


def write_report(
    recipe: Run,
    objective: Objective,
    result: Result,
    drawn: Mapping[str, Figure],
    folder: Path,
) -> None:
    """Write `report.md` and its figures."""
    assert result.objective is not None
    assert result.gap is not None
    lines = [f"# {recipe.path.stem}", ""]
    lines += [f"- **Note**: {warning}" for warning in result.caveats] + ([""] if result.caveats else [])
    lines += [
        f"Objective `{result.objective_kind}`: **{result.objective:.6g}**, gap {100 * result.gap:.3g} %. {result.fit}",
        "",
        f"{result.optimizer}, seed {result.seed}, {result.n_evaluation} evaluations in {result.n_generation} "
        f"generations. {result.status}",
        "",
    ]
    if result.gain is not None:
        lines += [f"Level of the measurement, fitted: {result.gain:.6g} (reading over SI unit).", ""]
    if result.parameters:
        lines += ["| parameter | value | standard error | unit | interval | |", "|---|---|---|---|---|---|"]
        space = objective.model.space
        for index, (name, found) in enumerate(result.parameters.items()):
            std = "not seen" if found.std is None else f"{found.std:.2g}"
            edge = "on its bound" if found.at_bound else ""
            interval = f"{float(space.low[index]):g} to {float(space.high[index]):g}"
            lines.append(f"| {name} | {found.value:.6g} | {std} | {found.unit} | {interval} | {edge} |")
        lines.append("")
    lines += _correlated(result)
    if (table := objective.evidence.natural_frequencies) is not None:
        lines += ["| mode | measured [Hz] | model [Hz] | difference |", "|---|---|---|---|"]
        hertzs = objective.natural_frequencies(result.theta).tolist()
        for mode, measured, hertz in zip(table.mode.tolist(), table.frequency.tolist(), hertzs, strict=True):
            lines.append(f"| {mode} | {measured:g} | {hertz:.2f} | {100 * (hertz / measured - 1):+.2f} % |")
        lines.append("")
    listed = ", ".join(f"{hertz:.2f}" for hertz in result.natural_frequencies_hz)
    lines += [f"Natural frequencies [Hz], undamped, rigid-body modes first: {listed}.", ""]
    if objective.evidence.measurement is not None:
        lines += ["![FRFs: measured, nominal, updated, and what is left](frf.png)", ""]
    if "natural_frequencies" in drawn:
        lines += ["![natural frequencies](natural_frequencies.png)", ""]
    if "convergence" in drawn:
        lines += ["![convergence](convergence.png)", ""]
    lines += ["## Where the channels sit", "", *_channels(recipe, objective)] if objective.evidence.measurement else []
    write_text(folder / "report.md", "\n".join(lines).rstrip() + "\n")
    for name, figure in drawn.items():
        save(figure, folder / f"{name}.png")


def _correlated(result: Result) -> list[str]:
    """The pairs of parameters that the data can hardly tell apart, and what that means."""
    pairs = result.correlated()
    if not pairs:
        return []
    lines = [
        f"The errors of these parameters go together (|correlation| > {CORRELATED:g}): the data fix a combination of "
        "the two better than either alone.",
        "",
        "| parameter | parameter | correlation |",
        "|---|---|---|",
    ]
    return [*lines, *(f"| {one} | {other} | {value:+.3f} |" for one, other, value in pairs), ""]


def _channels(recipe: Run, objective: Objective) -> list[str]:
    measurement = objective.evidence.measurement
    assert measurement is not None
    placement = recipe.placement(measurement)
    lines = [
        f"Matched by {placement.by}.",
        "",
        "| channel | x/Lx | y/Ly | nearest node | distance [mm] |",
        "|---|---|---|---|---|",
    ]
    for role, matches in (("response", placement.response), ("reference", placement.reference)):
        for match in matches:
            lines.append(
                f"| {role} {match.label} | {match.place[0]:.4f} | {match.place[1]:.4f} | {match.nearest_node} | "
                f"{1e3 * match.distance:.2f} |"
            )
    return lines
