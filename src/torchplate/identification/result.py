"""What was found, as `result.json` holds it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import ModePair, Objective, Sensitivity
from torchplate.identification.fit_quality import fit_in_words

# Beyond this correlation, either sign, two values can hardly be told apart.
CORRELATED = 0.9
# What is minimised where there is a table of natural frequencies and no FRF.
NATURAL_FREQUENCIES = "natural_frequencies"
# Likewise where mode shapes come with them.
MODAL_MODEL = "modal_model"


@dataclass(frozen=True)
class Value:
    """One searched parameter.

    Args:
        value: in `unit`.
        std: standard error in `unit`, from the noise of the measurement alone; None where the data cannot see it.
        unit: of both.
        at_bound: whether the value sits on the edge of its interval.
    """

    value: float
    std: float | None
    unit: str
    at_bound: bool


@dataclass(frozen=True, eq=False)
class Result:
    """The end of an identification.

    Args:
        parameters: by name, "label.parameter", in theta's order.
        objective: what was minimised, at these values; None where there was nothing to compare with.
        objective_kind: its name.
        gap: mean over FRFs of ‖measured − model‖ / ‖measured‖; of natural frequencies or modes alone their error
            [-].
        natural_frequencies_hz: the lowest of the full model [Hz], undamped, rigid-body modes first.
        n_evaluation: of the objective, over all searches.
        n_generation: the most that one of the searches finished.
        status: why the best search stopped, a sentence.
        seed: of all randomness.
        optimizer: name of the search.
        search: all settings of the search, as plain values.
        theta: the values as a tensor in SI units, as `PlateModel.frf` takes it.
        caveats: what must be known before the values are trusted, a sentence each.
        misread: those of them that stand first: a sign, phases or a factor of the FRFs that looks wrong.
        correlation: of the errors, a row for each parameter [-]; None beside one that the data cannot see.
        gain: the fitted level, reading over SI unit, where the measurement's is unknown.
        repeats: objective and values of each independent search, the best first, where there were several.
        basis_error: how far the reduced basis is off at the best, where one was used: relative FRF norm, or relative
            error of a natural frequency.
        modes: each mode of a measured modal model beside the model's.
        basis_error_of_population: the greatest estimated one among the best members of the last population.
        mesh_error_moved: by how much the natural frequencies of what was found were off with the mesh error of the
            middle of the box, relative, where it was taken off anew; None where it was not.
    """

    parameters: Mapping[str, Value]
    objective: float | None
    objective_kind: str | None
    gap: float | None
    natural_frequencies_hz: list[float]
    n_evaluation: int
    n_generation: int
    status: str
    seed: int
    optimizer: str
    search: Mapping[str, Any]
    theta: Float[Tensor, " n_parameter"]
    caveats: list[str] = field(default_factory=list)
    misread: list[str] = field(default_factory=list)
    correlation: list[list[float | None]] | None = None
    gain: float | None = None
    repeats: Mapping[str, Any] | None = None
    basis_error: float | None = None
    basis_error_of_population: float | None = None
    modes: list[ModePair] | None = None
    mesh_error_moved: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The content of `result.json`."""
        content: dict[str, Any] = {
            "schema": "torchplate.result/1",
            "objective": self.objective,
            "parameters": {name: vars(value).copy() for name, value in self.parameters.items()},
            "natural_frequencies_hz": list(self.natural_frequencies_hz),
            "n_evaluation": self.n_evaluation,
            "n_generation": self.n_generation,
            "status": self.status,
            "seed": self.seed,
            "optimizer": self.optimizer,
            "search": dict(self.search),
            "objective_kind": self.objective_kind,
            "gap": self.gap,
            "fit": self.fit,
        }
        if self.correlation is not None:
            content["correlation"] = {"names": list(self.parameters), "matrix": self.correlation}
        if self.gain is not None:
            content["gain"] = self.gain
        if self.modes is not None:
            content["modes"] = [
                {"mode": pair.mode, "measured_hz": pair.measured, "model_hz": pair.model, "mac": pair.mac}
                for pair in self.modes
            ]
        if self.repeats is not None:
            content["repeats"] = dict(self.repeats)
        if self.basis_error is not None:
            content["basis_error"] = self.basis_error
            content["basis_error_of_population"] = self.basis_error_of_population
        if self.mesh_error_moved is not None:
            content["mesh_error_moved"] = self.mesh_error_moved
        return content

    @property
    def fit(self) -> str | None:
        """How good the fit is, a sentence or two; None where nothing was compared."""
        if self.gap is None:
            return None
        of_frfs = self.objective_kind not in (NATURAL_FREQUENCIES, MODAL_MODEL)
        return fit_in_words(self.gap, of_frfs, bool(self.misread))

    def correlated(self) -> list[tuple[str, str, float]]:
        """Pairs of parameters whose errors are correlated beyond `CORRELATED`."""
        names, matrix = list(self.parameters), self.correlation or []
        return [
            (names[i], names[j], value)
            for i, row in enumerate(matrix)
            for j in range(i + 1, len(names))
            if (value := row[j]) is not None and abs(value) > CORRELATED
        ]


def values(objective: Objective, theta: Float[Tensor, " n_parameter"], seen: Sensitivity | None) -> dict[str, Value]:
    """The searched parameters at theta.

    Args:
        objective: whose model's they are.
        theta: in SI units.
        seen: what the data can see there; None where nothing is searched.
    """
    model = objective.model
    at_bound = model.space.at_bound(theta).tolist()
    return {
        name: Value(float(theta[index]), finite(seen.std[index]) if seen else None, model.units[index], at_bound[index])
        for index, name in enumerate(model.names)
    }


def finite(value: Tensor) -> float | None:
    """JSON has neither infinity nor NaN: a standard error that is infinite is None, and so are its correlations."""
    return float(value) if math.isfinite(float(value)) else None
