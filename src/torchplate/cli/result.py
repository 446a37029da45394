"""What a run found, as `result.json` holds it, and what a user must know before trusting it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from torchplate.cli.config import SearchConfig
from torchplate.discrepancy import Objective, Sensitivity
from torchplate.measurement.natural_frequencies import assumed
from torchplate.search import Outcome

# A standard error above this part of the interval says that the data hardly narrow it.
WIDE = 0.5
# Beyond this correlation, either sign, two values can hardly be told apart.
CORRELATED = 0.9


def evaluated(settings: SearchConfig, natural_frequencies: Sequence[float]) -> dict[str, Any]:
    """`result.json` of a model that is neither searched nor compared with anything.

    Args:
        settings: of a search, had there been one.
        natural_frequencies: the lowest of the full model [Hz].
    """
    return {
        "schema": "torchplate.result/1",
        "objective": None,
        "parameters": {},
        "natural_frequencies_hz": list(natural_frequencies),
        "n_evaluation": 1,
        "n_generation": 0,
        "status": "The model was evaluated: the config has no interval to search.",
        "seed": settings.seed,
        "optimizer": settings.optimizer,
        "search": settings.model_dump(mode="json"),
        "objective_kind": None,
        "gap": None,
    }


def summarise(
    objective: Objective,
    theta: Tensor,
    values: Tensor,
    seen: Sensitivity | None,
    outcome: Outcome | None,
    settings: SearchConfig,
    natural_frequencies: Sequence[float],
) -> dict[str, Any]:
    """The content of `result.json`.

    Args:
        objective: what was minimised.
        theta: values in SI units [n_search, n_parameter], the best first.
        values: their objective.
        seen: what the data can see at the best, None where nothing is searched.
        outcome: of the search, likewise.
        settings: of the search.
        natural_frequencies: the lowest of the full model [Hz].
    """
    model, best = objective.model, theta[0]
    at_bound = model.space.at_bound(best).tolist()
    result = evaluated(settings, natural_frequencies) | {
        "objective": float(values[0]),
        "parameters": {
            name: {
                "value": float(best[index]),
                "std": _finite(seen.std[index]) if seen else None,
                "unit": model.units[index],
                "at_bound": at_bound[index],
            }
            for index, name in enumerate(model.names)
        },
        "objective_kind": "natural_frequencies" if objective.evidence.measurement is None else objective.kind,
        "gap": float(objective.gap(best)),
    }
    if outcome is not None:
        result |= {
            "n_evaluation": int(outcome.n_evaluation.sum()),
            "n_generation": int(outcome.n_generation.max()),
            "status": status(outcome),
        }
    if seen is not None:
        correlation = [[_finite(number) for number in row] for row in seen.correlation]
        result["correlation"] = {"names": list(model.names), "matrix": correlation}
    if objective.evidence.gain_is_unknown:
        result["gain"] = float(objective.gain(best))
    if len(theta) > 1:
        result["repeats"] = {"objective": values.tolist(), "theta": theta.tolist()}
    return result


def status(outcome: Outcome) -> str:
    """Why the best search stopped."""
    return outcome.status[int(outcome.best_objective.argmin())].value


def caveats(objective: Objective, theta: Tensor, seen: Sensitivity) -> list[str]:
    """What must be known before the values are trusted, a sentence each: bounds, blind and flat directions."""
    space = objective.model.space
    sentences = []
    for index, name in enumerate(space.names):
        value, unit = f"{float(theta[index]):.6g}", space.units[index]
        low, high = float(space.low[index]), float(space.high[index])
        if bool(seen.blind[index]):
            sentences.append(
                f"The data cannot see {name}: no prediction changes over its whole interval, so its value "
                f"{value} means nothing. Give it as a number, or measure something that depends on it."
            )
            continue
        if bool(space.at_bound(theta)[index]):
            end = "upper" if float(theta[index]) > 0.5 * (low + high) else "lower"
            sentences.append(
                f"{name} ended on the {end} bound of its interval, {value} {unit}: the optimum lies beyond it, or an "
                "effect is missing that this parameter stands in for. Widen the interval, or look for the effect."
            )
        if not bool(seen.flat[:, index].any()) and float(seen.std[index]) > WIDE * (high - low):
            sentences.append(
                f"The data hardly see {name}: its standard error, {float(seen.std[index]):.3g} {unit}, is as wide "
                "as its interval. Measure where it acts, or give it as a number."
            )
    for direction in seen.flat:
        together = [
            name for name, part in zip(space.names, direction, strict=True) if abs(part) > 0.1 * direction.abs().max()
        ]
        sentences.append(
            f"The data see {' and '.join(together)} only together: moving them along one direction changes no "
            "prediction. Give one of them as a number."
        )
    if (table := objective.evidence.natural_frequencies) is not None and (said := assumed(table)):
        sentences.append(said)
    return sentences


def correlated(result: Mapping[str, Any]) -> list[tuple[str, str, float]]:
    """Pairs of parameters whose errors are correlated beyond `CORRELATED`, from the content of `result.json`."""
    table = result.get("correlation", {"names": [], "matrix": []})
    names, matrix = table["names"], table["matrix"]
    return [
        (names[i], names[j], matrix[i][j])
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if matrix[i][j] is not None and abs(matrix[i][j]) > CORRELATED
    ]


def _finite(value: Tensor) -> float | None:
    """JSON has neither infinity nor NaN: a standard error that is infinite is null, and so are its correlations."""
    return float(value) if math.isfinite(float(value)) else None


@torch.no_grad()
def nominal(objective: Objective) -> Tensor:
    """The model before updating: the middle of every interval, in SI units."""
    space = objective.model.space
    return space.to_si(torch.full_like(space.low, 0.5))
