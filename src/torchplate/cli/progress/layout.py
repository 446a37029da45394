"""What TensorBoard lays over each other: tags of one problem, and the charts of its page Custom Scalars.

A search's own tags (`search/best_objective`, ...) say nothing of the problem, so that charts of them hold every problem
below the folder. Here each run names its problem and asks for charts of that alone: DE and ABC lie over each other, by
the median and the quartiles over their seeds.
"""

import re
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

QUARTILES = {"median": 0.5, "lower_quartile": 0.25, "upper_quartile": 0.75}
"""In the order in which a chart with a margin takes them."""
BEST, GAP = "best_objective", "gap"
Layout = dict[str, dict[str, Any]]


def problem_named(config: str, overrides: Sequence[str]) -> str:
    """What names a problem, as a part of a tag: its config, and what was set in it but for the search and the log."""
    kept = [one for one in overrides if re.split(r"[.=]", one)[0] not in ("search", "log")]
    return "_".join(re.sub(r"[^\w.-]+", "_", word).strip("_") for word in (config, *kept))


def problem_tag(problem: str, *words: str) -> str:
    """Of a quantity of one problem."""
    return "/".join(("problem", problem, *words))


def quartiles(problem: str, quantity: str, values: Tensor) -> dict[str, float]:
    """Median and quartiles over the searches, by their tags.

    Args:
        problem: its name.
        quantity: that the values are of.
        values: of each search [n_search].
    """
    found = torch.quantile(values.detach().double(), values.new_tensor(list(QUARTILES.values()), dtype=torch.float64))
    return {problem_tag(problem, quantity, name): value for name, value in zip(QUARTILES, found.tolist(), strict=True)}


def of_a_search(problem: str, names: Sequence[str]) -> Layout:
    """The charts of a problem that is searched.

    Args:
        problem: its name.
        names: searched parameters.
    """
    heads = {BEST: "best objective"} | {name: name for name in names}
    charts: dict[str, Any] = {}
    for key, head in heads.items():
        tags = [problem_tag(problem, key, name) for name in QUARTILES]
        charts[f"{head}: median and quartiles over the seeds"] = ["Margin", tags]
    return {problem: charts | {"gap": ["Multiline", [f"{re.escape(problem_tag(problem, GAP))}$"]]}}


def of_a_diagnosis() -> Layout:
    """The charts of a diagnosis: the gap of each of its models, as levels over each other."""
    return {
        "Diagnosis": {
            "gap of each model": ["Multiline", ["gap/(?!heldout/)"]],
            "gap of each model on FRFs that no fit has used": ["Multiline", ["gap/heldout/"]],
        }
    }
