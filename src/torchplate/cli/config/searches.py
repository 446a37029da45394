"""The searches that a config can ask for, and what it says of one."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from torchplate.cli.config.memory import available
from torchplate.cli.config.recipe import Recipe
from torchplate.cli.schema import Config, SearchConfig, unknown_key
from torchplate.search import OPTIMIZERS, LeastSquares, Optimizer, unknown_name

# Every search by its name in a config: those that ask and tell, and the one that needs residuals.
SEARCHES: dict[str, type[Any]] = OPTIMIZERS | {LeastSquares.name: LeastSquares}
# What all searches share and this one, whose starts stop one by one, does not take.
_NOT_OF_LEAST_SQUARES = ("target", "tolerance", "stagnation")

# Of each number of each member: the population, what is proposed, what was best, and their copies.
BYTES_PER_NUMBER = 80.0


def optimizer_of(recipe: Recipe) -> Optimizer[Any] | LeastSquares:
    """The search that a config asks for, with its settings.

    Raises:
        InputError: if there is none of that name, or a setting cannot be used.
    """
    name = recipe.config.search.optimizer
    if name not in SEARCHES:
        raise recipe.error("search.optimizer", unknown_name("optimizer", name, SEARCHES))
    kind = SEARCHES[name]
    fields = [field.name for field in dataclasses.fields(kind)]
    settings = dict(recipe.config.search.model_extra or {})
    for key in settings:
        if key not in fields:
            raise recipe.error(f"search.{key}", unknown_key(key, [*fields, *SearchConfig.model_fields], "search"))
    settings = recipe.typed("search", kind, settings)
    optimizer = recipe.told("search", lambda: kind(**settings))
    _check_memory(recipe, optimizer.n_member)
    if isinstance(optimizer, LeastSquares):
        _check_least_squares(recipe, optimizer)
        return optimizer
    budget = recipe.config.search.n_evaluation
    if budget is not None and budget < optimizer.n_member:
        raise recipe.error(
            "search.n_evaluation",
            f"Expected at least the {optimizer.n_member} evaluations of the first population, got {budget}. Raise "
            "it, or lower search.n_member.",
        )
    return optimizer


def _check_memory(recipe: Recipe, n_member: int) -> None:
    """Whether the members, their fitness and those that are proposed fit the machine; models take their share apart."""
    n_repeat, memory = recipe.config.search.n_repeat, available()
    need = BYTES_PER_NUMBER * float(n_member) * float(n_repeat) * max(1, len(recipe.searched_names()))
    if memory is not None and need > memory:
        raise recipe.error(
            "search.n_member",
            f"Expected a population that fits the {memory / 1e9:.3g} GB of memory that are free, got {n_member:g} "
            f"members in {n_repeat:g} searches, which take about {need / 1e9:.3g} GB. Lower it, or search.n_repeat.",
        )


def _check_least_squares(recipe: Recipe, settings: LeastSquares) -> None:
    """Whether the keys that all searches share mean something to this one."""
    search = recipe.config.search
    for key in _NOT_OF_LEAST_SQUARES:
        if key in search.model_fields_set:
            raise recipe.error(
                f"search.{key}",
                f"Expected it left out with least_squares, whose starts stop one by one, got "
                f"{getattr(search, key)}. Take it out; search.n_generation and search.n_evaluation limit the search.",
            )
    n_dimension = len(recipe.searched_names())
    least = settings.n_member * settings.price(n_dimension)
    if search.n_evaluation is not None and search.n_evaluation < least:
        raise recipe.error(
            "search.n_evaluation",
            f"Expected at least {least}, for {settings.n_member} starts and their Jacobians, got "
            f"{search.n_evaluation}. Raise it, or lower search.n_member.",
        )


def foreign(config: Config, overrides: Sequence[str]) -> list[str]:
    """Keys of the file's own optimiser where an override names another one; keys that no optimiser has stay."""
    given = {override.partition("=")[0] for override in overrides}
    name = config.search.optimizer
    if "search.optimizer" not in given or name not in SEARCHES:
        return []
    own = {field.name for field in dataclasses.fields(SEARCHES[name])}
    others = {field.name for kind in SEARCHES.values() for field in dataclasses.fields(kind)} - own
    found = [key for key in config.search.model_extra or {} if key in others]
    if name == LeastSquares.name:
        found += [key for key in _NOT_OF_LEAST_SQUARES if key in config.search.model_fields_set]
    return [key for key in found if f"search.{key}" not in given]
