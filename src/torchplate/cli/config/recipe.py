"""A checked config, what it says of the plate, and how it complains."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from torchplate.cli.config.file import InputError
from torchplate.cli.config.memory import complaint
from torchplate.cli.schema import Config, MeshConfig, Unknown, misplaced, quantity, typed, unknown_key
from torchplate.effects import CATALOGUE, Effect, Parameter, find_effect, options
from torchplate.model import Searched
from torchplate.plate import Mesh

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A checked config, and where it was read from.

    Attributes:
        path: of the YAML file.
        raw: what it says, overrides included.
        config: the same, checked.
        dropped: what an override has made meaningless and is left out, a sentence each.
    """

    path: Path
    raw: dict[str, Any]
    config: Config
    dropped: tuple[str, ...] = ()

    def error(self, key: str, message: str) -> InputError:
        """One sentence that names this file and a key of it."""
        return InputError(f"{self.path}: {key}: {message}")

    def told(self, key: str, make: Callable[[], T]) -> T:
        """What `make` returns; its complaint about the user's input gains the file and the key."""
        try:
            return make()
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, FileNotFoundError) as error:
            text = str(error.args[0]) if error.args else str(error)
            raise self.error(key, text) from error

    def typed(self, key: str, owner: type, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Settings in the types that their dataclass declares."""
        return {
            name: self.told(f"{key}.{name}", lambda name=name, value=value: typed(owner, name, value))  # type: ignore[misc]
            for name, value in settings.items()
        }

    def parts(self, refine: int = 1) -> tuple[Mesh, dict[str, Effect], dict[str, float], dict[str, Searched]]:
        """Mesh, effects, known values and intervals.

        Args:
            refine: split each element of the config's mesh once more, in refine × refine.
        """
        settings = self.config.mesh
        self.check_memory(refine, finer=2 if settings.extrapolate else 1)
        sides = settings.length_x.value, settings.length_y.value
        mesh = self.told(
            "mesh",
            lambda: Mesh(
                *sides,
                settings.n_x,
                settings.n_y,
                settings.refine * refine,
                settings.edges,
                settings.extrapolate,
                settings.cut,
            ),
        )
        effects: dict[str, Effect] = {}
        known: dict[str, float] = {}
        searched: dict[str, Searched] = {}
        for label, body in self.config.effects.items():
            key = f"effects.{label}"
            if "effect" not in body:
                raise self.error(
                    f"{key}.effect", f"Expected the name of an effect, got none. Add `effect: {_likely(body)}`, say."
                )
            kind = self.told(f"{key}.effect", lambda body=body: find_effect(str(body["effect"])))  # type: ignore[misc]
            fixed = self.typed(key, kind, {name: body[name] for name in options(kind) if name in body})
            parameters = _parameters(kind, fixed)
            for name, value in body.items():
                if name == "effect" or name in fixed:
                    continue
                if name in MeshConfig.model_fields and name not in parameters:
                    raise self.error(f"{key}.{name}", misplaced(f"{key}.{name}", f"mesh.{name}"))
                if name not in parameters:
                    raise self.error(
                        f"{key}.{name}", unknown_key(name, [*parameters, *options(kind)], f"effects.{kind.name}")
                    )
                number = self.told(f"{key}.{name}", lambda value=value: quantity(value))  # type: ignore[misc]
                if isinstance(number, Unknown):
                    searched[f"{label}.{name}"] = Searched(number.low, number.high, number.scale == "log")
                else:
                    known[f"{label}.{name}"] = number.value
            effects[label] = self.told(key, lambda kind=kind, fixed=fixed: kind(**fixed))  # type: ignore[misc]
            # Said here, where the key is known, rather than at the first evaluation.
            if nodes := fixed.get("nodes") or fixed.get("at"):
                self.told(f"{key}.{'nodes' if 'nodes' in fixed else 'at'}", lambda nodes=nodes: mesh.places(nodes))  # type: ignore[misc]
        return mesh, effects, known, searched

    def searched_names(self) -> list[str]:
        """Searched parameters, "label.parameter"."""
        return list(self.parts()[3])

    def check_memory(self, refine: int = 1, finer: int = 1) -> None:
        """Whether the mesh fits the machine; see `memory.complaint`.

        Raises:
            InputError: if it does not.
        """
        if (told := complaint(self.config.mesh, refine, finer)) is not None:
            raise self.error("mesh", told)


def _likely(body: Mapping[str, Any]) -> str:
    """The effect that takes all these names and the fewest others; plate where none does."""
    taken = {name: {*kind.parameters, *options(kind)} for name, kind in CATALOGUE.items()}
    fitting = [name for name in taken if body and set(body) <= taken[name]]
    return min(fitting, key=lambda name: len(taken[name]), default="plate")


def _parameters(kind: type[Effect], fixed: Mapping[str, Any]) -> Mapping[str, Parameter]:
    """What an effect takes with its options as given; while these cannot be used, which is said later, at all."""
    try:
        return kind(**fixed).parameters
    except (ValueError, TypeError):
        return kind.parameters
