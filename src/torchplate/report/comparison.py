"""Searches beside each other: one content in Markdown, CSV, LaTeX and figures for paper; quartiles over the seeds."""

import csv
import io
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from torchplate.notation import percent
from torchplate.report.blocks.document import Document, Panel, Picture, Table
from torchplate.report.blocks.numbers import with_unit
from torchplate.report.figures.drawing import pdf, png
from torchplate.report.figures.style import COLOURS, INK, dress
from torchplate.report.forms.latex import latex
from torchplate.report.forms.markdown import markdown
from torchplate.report.run_figures import Convergence, convergence, convergence_told

WITHIN = 0.01
"""A search counts as arrived when its best objective is within this part of the best that any run found."""
QUANTILES = {"minimum": 0.0, "lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75, "maximum": 1.0}
DPI, N_COLOUR = 90, 64


class Compared(NamedTuple):
    """Searches of one kind, put together over runs and seeds.

    Attributes:
        history: best objective over evaluations and generations, a row for each search.
        parameters: names of the searched parameters, and their units.
        theta: where each search ended, in SI units [n_search, n_parameter].
        objective: the objective there [n_search].
        evaluations: evaluations until within 1 % of the best of all runs; NaN where a search never was.
        run: the folder that each search is from.
    """

    history: Convergence
    parameters: dict[str, str]
    theta: np.ndarray
    objective: np.ndarray
    evaluations: np.ndarray
    run: tuple[str, ...]

    @property
    def arrived(self) -> np.ndarray:
        """Of each search, whether it came within 1 % of the best."""
        return np.isfinite(self.evaluations)


def comparison_tables(groups: Mapping[str, Compared]) -> tuple[Table, Table]:
    """How the searches went, and where they ended; a column and a row for each."""
    first = next(iter(groups.values()))
    rows = [["searches"], ["best objective"], ["median"], ["quartiles"], ["evaluations"]]
    rows += [[f"evaluations to within {percent(WITHIN)} of the best"], ["searches that came there"]]
    for group in groups.values():
        lower, middle, upper = np.quantile(group.objective, [0.25, 0.5, 0.75])
        arrived = group.arrived
        cells = (
            str(len(group.objective)),
            f"{group.objective.min():.6g}",
            f"{middle:.6g}",
            f"{lower:.6g} to {upper:.6g}",
            f"{np.median(group.history.n_evaluation[:, -1]):.0f}",
            f"{np.median(group.evaluations[arrived]):.0f}" if arrived.any() else "never",
            f"{arrived.sum()} of {len(arrived)}",
        )
        for row, cell in zip(rows, cells, strict=True):
            row.append(cell)
    found = [[name, *_values(group)] for name, group in groups.items()]
    heads = [f"{name}{f' [{unit}]' if with_unit(unit) else ''}>" for name, unit in first.parameters.items()]
    return (
        Table("How the searches went; the objective over their seeds.", ["", *(f"{name}>" for name in groups)], rows),
        Table("Where they ended: the median over the seeds, and the quartiles.", ["search", *heads], found),
    )


def _values(group: Compared) -> list[str]:
    if len(group.theta) == 1:
        return [f"{value:.6g}" for value in group.theta[0]]
    spread = np.quantile(group.theta, [0.25, 0.5, 0.75], axis=0).T
    return [f"{middle:.6g} ({low:.6g} to {high:.6g})" for low, middle, high in spread]


def comparison_report(groups: Mapping[str, Compared], objective: str) -> dict[str, bytes]:
    """The content of each file by its name.

    `comparison.md` with `comparison.png`; `comparison.csv`, quantiles over the seeds; `searches.csv`, a row for each
    search; `comparison.tex`, the tables; `convergence.pdf` and `values.pdf`, for paper.

    Args:
        groups: what is compared, by the settings of the searches.
        objective: what was minimised.
    """
    histories = {name: group.history for name, group in groups.items()}
    tables = comparison_tables(groups)
    drawn = convergence(histories, objective)
    panel = Panel(partial(convergence, histories, objective), convergence_told(histories, objective))
    picture = Picture("comparison", "The best objective so far: median, and quartiles where seeds repeat.", (panel,))
    document = Document("Searches compared", _first(groups, objective), "told", [*tables, picture])
    return {
        "comparison.md": markdown(document).encode(),
        "comparison.png": png(drawn, DPI, N_COLOUR),
        "comparison.csv": _quantiles(groups).encode(),
        "searches.csv": _searches(groups).encode(),
        "comparison.tex": latex(tables).encode(),
        "convergence.pdf": pdf(drawn),
        "values.pdf": pdf(values_figure(groups)),
    }


def _first(groups: Mapping[str, Compared], objective: str) -> str:
    """The sentence that is read first."""
    middle = {name: float(np.median(group.objective)) for name, group in groups.items()}
    name = min(middle, key=middle.__getitem__)
    lower, upper = np.quantile(groups[name].objective, [0.25, 0.75])
    n_search = len(groups[name].objective)
    seeds = f" (quartiles {lower:.6g} to {upper:.6g} over {n_search} searches)" if n_search > 1 else ""
    return f"Least median of {objective}: {middle[name]:.6g}{seeds}, by {name}."


def _quantiles(groups: Mapping[str, Compared]) -> str:
    """A row for each search and quantity."""
    rows = []
    for name, group in groups.items():
        quantities = {
            ("objective", ""): group.objective,
            ("evaluations", ""): group.history.n_evaluation[:, -1],
            (f"evaluations to within {percent(WITHIN)} of the best", ""): group.evaluations[group.arrived],
        }
        quantities |= {key: group.theta[:, index] for index, key in enumerate(group.parameters.items())}
        for (quantity, unit), values in quantities.items():
            found = np.quantile(values, list(QUANTILES.values())) if len(values) else [float("nan")] * len(QUANTILES)
            rows.append([name, quantity, unit, len(values), *(f"{value:.10g}" for value in found)])
    return _csv(["search", "quantity", "unit", "n", *QUANTILES], rows)


def _searches(groups: Mapping[str, Compared]) -> str:
    """A row for each search; the values in the units of the heads."""
    parameters = next(iter(groups.values())).parameters
    rows = [
        [
            name,
            run,
            *(f"{value:.10g}" for value in (steps[-1], objective, evaluations, *theta)),
        ]
        for name, group in groups.items()
        for run, steps, objective, evaluations, theta in zip(
            group.run, group.history.n_evaluation, group.objective, group.evaluations, group.theta, strict=True
        )
    ]
    heads = [f"{name} [{unit}]" for name, unit in parameters.items()]
    arrival = f"evaluations to within {percent(WITHIN)} of the best"
    return _csv(["search", "run", "evaluations", "objective", arrival, *heads], rows)


def _csv(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return written.getvalue()


def values_figure(groups: Mapping[str, Compared]) -> Figure:
    """Where the searches ended, a panel for each parameter: least to largest, quartiles, median."""
    parameters = next(iter(groups.values())).parameters
    n_panel = max(len(parameters), 1)
    figure = Figure(figsize=(9, n_panel * (0.75 + 0.28 * len(groups))), layout="constrained")
    axes = figure.subplots(n_panel, 1, squeeze=False)[:, 0]
    for index, (axis, (name, unit)) in enumerate(zip(axes, parameters.items(), strict=False)):
        for row, group in enumerate(groups.values()):
            least, lower, middle, upper, most = np.quantile(group.theta[:, index], list(QUANTILES.values()))
            colour = COLOURS[row % len(COLOURS)]
            axis.plot([least, most], [row, row], color=colour, lw=1.0)
            axis.plot([lower, upper], [row, row], color=colour, lw=5.0, alpha=0.35, solid_capstyle="butt")
            axis.plot([middle], [row], "o", color=colour, ms=5.0)
        axis.set_yticks(range(len(groups)), list(groups))
        axis.set_ylim(len(groups) - 0.5, -0.5)
        axis.set_title(f"{name}{f' [{unit}]' if with_unit(unit) else ''}", loc="left", fontsize=9.5, color=INK)
        dress(axis)
        axis.grid(False, axis="y")
    return figure
