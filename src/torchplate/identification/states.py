"""One plate in several states: parameters that are common to all, and parameters with a value in each.

The joint parameters are the common ones, then each state's own, "label.parameter@state". A state's objective is that of
its own model; what is minimised is their mean, so that every state counts alike however many FRFs it has.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Evidence, Objective, Rows
from torchplate.model import ParameterSpace, PlateModel


@dataclasses.dataclass(frozen=True, eq=False)
class PlateState:
    """One state of a plate, and what was measured of it.

    Args:
        name: of the state.
        objective: of its own model.
        own: its searched parameters, "label.parameter", that have a value of their own in this state.

    Raises:
        ValueError: if it has no such parameter, or the name cannot stand behind an @.
    """

    name: str
    objective: Objective
    own: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, name: str, model: PlateModel, evidence: Evidence, own: Sequence[str] = (), kind: str = "relative_frf_norm"
    ) -> "PlateState":
        """A state from its model and what was measured; `kind` is the objective's."""
        return cls(name, Objective(model, evidence, kind), tuple(own))

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_-]+", self.name):
            raise ValueError(
                f"Expected a state's name of letters, digits, - and _, got '{self.name}'. It stands behind "
                "the @ of its own parameters: rename it."
            )
        for name in self.own:
            if name not in self.objective.model.names:
                raise ValueError(
                    f"Expected own parameters of state '{self.name}' among those it searches "
                    f"({', '.join(self.objective.model.names) or 'none'}), got '{name}'. Correct the name, or give the "
                    "parameter an interval."
                )


class JointModel(NamedTuple):
    """What a search sees of several models.

    Attributes:
        names: of the joint parameters.
        space: their box.
        known: a tensor of the models' precision and device.
    """

    names: tuple[str, ...]
    space: ParameterSpace
    known: Tensor

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the joint parameters."""
        return self.space.units

    def in_single_precision(self) -> "JointModel":
        """The same: it is the states' own models that do this, see `States.of`."""
        return self


class States(Objective):
    """Several states of one plate as one objective; its `model` is a `JointModel`.

    Args:
        states: in the order in which they were measured.

    Raises:
        ValueError: if there is none, two have one name, or a common parameter has other intervals in another state.
    """

    def __init__(self, states: Sequence[PlateState]) -> None:
        self.states = tuple(states)
        names = [one.name for one in self.states]
        if not names:
            raise ValueError("Expected at least one state of the plate, got none. Give a list of PlateState.")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"Expected each state's name once, got '{twice}' twice. Rename one of them.")
        found: dict[str, tuple[str, Any]] = {}
        self._index: list[list[str]] = []
        for one in self.states:
            model = one.objective.model
            own = [f"{name}@{one.name}" if name in one.own else name for name in model.names]
            self._index.append(own)
            for joint, name, unit in zip(own, model.names, model.units, strict=True):
                interval = model.searched[name]
                if joint in found and found[joint][1] != interval:
                    raise ValueError(
                        f"Expected one interval of {name} in all states, got {_told(found[joint][1])} and "
                        f"{_told(interval)} in '{one.name}'. Make it that state's own, or give it once."
                    )
                found.setdefault(joint, (unit, interval))
        order = sorted(found, key=lambda name: "@" in name)
        space = ParameterSpace(order, [found[name][0] for name in order], [found[name][1] for name in order])
        known = self.states[0].objective.model.known
        # A search asks a model for its names, its box and its device alone.
        self.model = cast("PlateModel", JointModel(tuple(order), space.to(known.device), known))
        first = self.states[0].objective
        self.evidence, self.kind, self.measure = first.evidence, first.kind, first.measure
        self.natural_frequency_weight = first.natural_frequency_weight
        self._index_of = [torch.tensor([order.index(name) for name in own], device=known.device) for own in self._index]

    def of(self, model: Any) -> "States":
        """The same in single precision, which is all that a search asks another model for.

        Args:
            model: the joint one.

        Raises:
            ValueError: if it is another.
        """
        if model is not self.model:
            raise ValueError("Expected the joint model of these states, got another. Use `each` for other models.")
        return self.each(lambda objective: objective.of(objective.model.in_single_precision()))

    def theta_of(self, state: int, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_own"]:
        """The parameters of one state's own model."""
        return theta[..., self._index_of[state]]

    def names_of(self, state: int) -> list[str]:
        """The joint names of one state's parameters, in its own model's order."""
        return self._index[state]

    def replaced(self, objectives: Sequence[Objective]) -> "States":
        """The same with other objectives of the same parameters."""
        pairs = zip(self.states, objectives, strict=True)
        return States([dataclasses.replace(one, objective=objective) for one, objective in pairs])

    def each(self, change: Callable[[Objective], Objective]) -> "States":
        """The same with each objective changed."""
        return self.replaced([change(one.objective) for one in self.states])

    def __call__(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The mean over states of their objectives."""
        return self._mean(theta, lambda objective, own: objective(own))

    def gap(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch"]:
        """The mean over states of their gaps [-]."""
        return self._mean(theta, lambda objective, own: objective.gap(own))

    def _mean(self, theta: Tensor, of: Callable[[Objective, Tensor], Tensor]) -> Tensor:
        parts = [of(one.objective, self.theta_of(k, theta)) for k, one in enumerate(self.states)]
        return torch.stack(parts).mean(0)

    def residual(self, theta: Float[Tensor, "*batch n_parameter"]) -> Float[Tensor, "*batch n_residual"]:
        """Residuals of all states, one after another."""
        parts = [one.objective.residual(self.theta_of(k, theta)) for k, one in enumerate(self.states)]
        return torch.cat(parts, dim=-1)

    def rows(self, theta: Float[Tensor, " n_parameter"]) -> Rows:
        """What each residual belongs to; no group belongs to two states."""
        parts: list[Rows] = []
        n_group = 0
        for k, one in enumerate(self.states):
            rows = one.objective.rows(self.theta_of(k, theta))
            parts.append(rows._replace(group=rows.group + n_group))
            n_group += 1 + int(rows.group.max())
        return Rows(*(torch.cat(columns) for columns in zip(*parts, strict=True)))

    def estimating_weight(self, residual: Float[Tensor, " n_residual"], rows: Rows) -> Float[Tensor, " n_residual"]:
        """W of the equations Jᵀ W r = 0 that hold where the mean is least, up to a factor."""
        found, first, n_group = [], 0, 0
        for one in self.states:
            last = first + _n_residual(one.objective)
            part = Rows(*(column[first:last] for column in rows))
            part = part._replace(group=part.group - n_group)
            found.append(one.objective.estimating_weight(residual[first:last], part))
            n_group, first = n_group + 1 + int(part.group.max()), last
        return torch.cat(found)


def _n_residual(objective: Objective) -> int:
    model = objective.model
    middle = model.space.to_si(torch.full((len(model.names),), 0.5).to(model.known))
    return len(objective.residual(middle))


def _told(interval: Any) -> str:
    return f"[{interval.low:g}, {interval.high:g}]{' log' if interval.logarithmic else ''}"


def by_state(names: Sequence[str]) -> Mapping[str, list[str]]:
    """Joint names by their state; the common ones under an empty name."""
    found: dict[str, list[str]] = {"": []}
    for name in names:
        found.setdefault(name.partition("@")[2], []).append(name)
    return found
