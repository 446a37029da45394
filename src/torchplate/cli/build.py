"""From a checked config to what a run needs: model, evidence, objective, optimiser."""

import dataclasses
import functools
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from torchplate.cli.config import (
    Config,
    FrameConfig,
    InputError,
    SearchConfig,
    Unknown,
    checked,
    quantity,
    read_config,
    typed,
    unknown_key,
)
from torchplate.cli.memory import complaint
from torchplate.cli.schema import StateConfig, validated, validated_states
from torchplate.discrepancy import OBJECTIVES, Evidence, ModalEvidence, Objective
from torchplate.effects import Effect, Parameter, find_effect, options
from torchplate.measurement import (
    Channel,
    Frame,
    Imperfections,
    Measurement,
    ModalModel,
    NaturalFrequencies,
    Placement,
    disagreements,
    in_frame,
    place,
    read_measurement,
    read_modal_model,
    read_nodes,
    with_nodes,
)
from torchplate.model import PlateModel, Point, Searched, extrapolate, impossible, unusual
from torchplate.nearest import did_you_mean
from torchplate.plate import Mesh
from torchplate.search import OPTIMIZERS, LeastSquares, Optimizer, unknown_name

T = TypeVar("T")
# Every search by its name in a config: those that ask and tell, and the one that needs residuals.
SEARCHES: dict[str, type[Any]] = OPTIMIZERS | {LeastSquares.name: LeastSquares}


@dataclasses.dataclass(frozen=True)
class Run:
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

    @functools.cached_property
    def states(self) -> "tuple[State, ...]":
        """Each state of a plate, where `measurement` is a list; empty where it is one."""
        if not isinstance(self.raw.get("measurement"), list):
            return ()
        pairs = validated_states(self.raw)
        return tuple(
            State(one.name, _own_of(self, one, run), run)
            for one, alone in pairs
            for run in (Run(self.path, alone, validated(alone), self.dropped),)
        )

    def model(self, refine: int = 1) -> PlateModel:
        """The model it describes, with the measurement's responses, references and kind where there is one.

        Args:
            refine: split each element of the config's mesh once more, in refine × refine.
        """
        model = self.model_as_given(refine)
        if not model.mesh.extrapolate:
            return model
        band = self.config.measurement.band
        frfs = self.measurement() if self.has_file else None
        top = float(frfs.frequency.max()) if frfs is not None else None if band is None else band[1]
        return extrapolate(model, top).model

    @property
    def has_file(self) -> bool:
        """Whether the measurement's file is there."""
        file = self.config.measurement.file
        return file is not None and (self.path.parent / file).exists()

    def model_as_given(self, refine: int = 1) -> PlateModel:
        """The same, its mesh error in it even where the config wants it taken off."""
        mesh, effects, known, searched = self._parts(refine)
        measurement = self.config.measurement
        response: Sequence[Point] | None = measurement.response
        reference: Sequence[Point] | None = measurement.reference
        kind: str | None = measurement.kind
        if self.has_file:
            frfs = self.measurement()
            assert frfs is not None
            found = self.placement(frfs)
            response = [spot.place for spot in found.response]
            reference = [spot.place for spot in found.reference] or None
            kind = frfs.kind
        for name, points in (("response", response), ("reference", reference)):
            if mesh.cut and points:
                self.told(f"measurement.{name}", lambda points=points: mesh.check_on_plate(points))  # type: ignore[misc]
        model = self.told(
            "effects", lambda: PlateModel(mesh, effects, known, searched, response, reference, kind or "receptance")
        )
        if (wrong := impossible(model)) is not None:
            raise self.error(*wrong)
        return model

    def _parts(self, refine: int) -> tuple[Mesh, dict[str, Effect], dict[str, float], dict[str, Searched]]:
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
                raise self.error(f"{key}.effect", "Expected the name of an effect, got none. Add `effect: plate`, say.")
            kind = self.told(f"{key}.effect", lambda body=body: find_effect(str(body["effect"])))  # type: ignore[misc]
            fixed = self.typed(key, kind, {name: body[name] for name in options(kind) if name in body})
            parameters = _parameters(kind, fixed)
            for name, value in body.items():
                if name == "effect" or name in fixed:
                    continue
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
        return list(self._parts(1)[3])

    def check_memory(self, refine: int = 1, finer: int = 1) -> None:
        """Whether the mesh fits the machine; see `memory.complaint`.

        Raises:
            InputError: if it does not.
        """
        if (told := complaint(self.config.mesh, refine, finer)) is not None:
            raise self.error("mesh", told)

    def measurement(self) -> Measurement | None:
        """The FRFs of the measurement file, cut to the band, without dead ones; None where the config names no file."""
        return self._frfs

    @functools.cached_property
    def _frfs(self) -> Measurement | None:
        settings = self.config.measurement
        if settings.file is None:
            return None
        path = self.path.parent / settings.file
        if not path.exists():
            here = (
                f" {settings.file} is there, but paths count from the config's folder:"
                if settings.file.exists()
                else ""
            )
            near = os.path.relpath(settings.file, self.path.parent)
            action = f"{here} write {near}." if here else " Correct the path, which counts from the config's folder."
            raise self.error("measurement.file", f"Expected a file, found none at {path}.{action}")
        frame = self.told("measurement.frame", lambda: Frame(**(settings.frame or FrameConfig()).model_dump()))
        frfs = self.told("measurement.file", lambda: read_measurement(path, settings.kind, frame.normal))
        if settings.nodes is not None:
            table = self.path.parent / settings.nodes
            frfs = self.told("measurement.nodes", lambda: with_nodes(frfs, read_nodes(table), str(table)))
        if settings.frame is not None:
            frfs = in_frame(frfs, frame)
        if settings.band is not None:
            band = settings.band
            frfs = self.told("measurement.band", lambda: frfs.band(*band))
        return self.told("measurement.file", frfs.without_zeros)

    def placement(self, frfs: Measurement) -> Placement:
        """Where the measurement's responses and references sit on the plate."""
        settings = self.config.mesh
        sides = settings.length_x.value, settings.length_y.value
        return self.told("measurement.file", lambda: place(frfs, *sides, settings.n_x, settings.n_y))

    @functools.cached_property
    def modal_model(self) -> ModalModel | None:
        """The modes of the modal model's file within the band, its points on the plate; None where there is none."""
        settings = self.config.measurement
        if settings.modal_model is None:
            return None
        path = self.path.parent / settings.modal_model.file
        frame = self.told("measurement.frame", lambda: Frame(**(settings.frame or FrameConfig()).model_dump()))
        found = self.told("measurement.modal_model", lambda: read_modal_model(path, frame.normal))
        if settings.nodes is not None:
            table = self.path.parent / settings.nodes
            nodes = self.told("measurement.nodes", lambda: read_nodes(table))
            if missing := sorted({one.node for one in found.point} - set(nodes)):
                raise self.error(
                    "measurement.nodes",
                    f"Expected every point of the mode shapes, got none of {missing[:6]}. Add them.",
                )
            found = found.with_points(lambda one: dataclasses.replace(one, coordinate=nodes[one.node]))
        if settings.frame is not None:
            found = found.with_points(lambda one: _moved(one, frame))
        if settings.band is not None:
            band = settings.band
            found = self.told("measurement.band", lambda: found.band(*band))
        return found

    def modal_evidence(self, model: PlateModel) -> ModalEvidence | None:
        """The same as evidence on a plate."""
        settings, modal = self.config.measurement.modal_model, self.modal_model
        if settings is None or modal is None:
            return None
        return self.told(
            "measurement.modal_model",
            lambda: ModalEvidence.of(model, modal, settings.frequency_std, settings.shape_std),
        )

    def evidence(self, model: PlateModel) -> Evidence:
        """What the run compares the model with."""
        settings = self.config.measurement
        table = None
        if settings.natural_frequencies is not None:
            values = {mode: number.value for mode, number in settings.natural_frequencies.items()}
            spread = {mode: number.std for mode, number in settings.natural_frequencies.items() if number.std}
            table = self.told(
                "measurement.natural_frequencies", lambda: NaturalFrequencies.from_mapping(values, spread)
            )
        frfs, modal = self.measurement(), self.modal_evidence(model)
        if frfs is None and table is None and modal is None:
            raise self.error("measurement", "Expected a file or natural_frequencies, got neither. Add one of them.")
        return self.told(
            "measurement", lambda: Evidence(frfs, table, settings.gain == "unknown", settings.n_average, modal)
        )

    def remarks(self, model: PlateModel) -> tuple[str, ...]:
        """What a user must know before a search, one sentence each.

        What an override has made meaningless, how the channels were matched to the plate, what was left out of the
        measurement file, sizes and moduli that few plates have, and what no value in the intervals can mend:
        frequencies, kind and level that do not fit.

        Args:
            model: of this config.
        """
        settings = self.config.measurement
        found = [f"{key}: {sentence}" for key, sentence in unusual(model)]
        frfs, table = self.measurement(), settings.natural_frequencies
        if frfs is not None:
            found = [self.placement(frfs).remark, *frfs.notes, *found]
        if (modal := self.modal_evidence(model)) is not None:
            found = [modal.remark, *modal.modal.notes, *found]
        if frfs is not None or table is not None:
            evidence = self.evidence(model)
            found += disagreements(model, evidence.measurement, evidence.natural_frequencies, evidence.gain_is_unknown)
        if modal is not None:
            found += disagreements(model, table=modal.table(model))
        return (*self.dropped, *found)

    def imperfections(self) -> Imperfections:
        """What the test is not perfect in, as far as the config tells."""
        settings = self.config.measurement
        return Imperfections(
            **{field.name: getattr(settings, field.name) for field in dataclasses.fields(Imperfections)}
        )

    def objective(self, model: PlateModel) -> Objective:
        """The function of theta that the run minimises."""
        if self.config.objective.kind not in OBJECTIVES:
            raise self.error("objective.kind", unknown_key(self.config.objective.kind, OBJECTIVES, "objective"))
        evidence = self.evidence(model)
        if (table := evidence.natural_frequencies) is not None and int(table.mode.max()) > model.assembly.size:
            raise self.error(
                "measurement.natural_frequencies",
                f"Expected modes up to {model.assembly.size}, as many as the mesh has, got mode "
                f"{int(table.mode.max())}. Raise mesh.refine, or leave it out.",
            )
        if evidence.measurement is not None:
            self.told("effects", model.check_channels)
        settings = self.config.objective
        return self.told(
            "objective.kind", lambda: Objective(model, evidence, settings.kind, settings.natural_frequency_weight)
        )

    def optimizer(self) -> Optimizer[Any] | LeastSquares:
        """The search's settings."""
        name = self.config.search.optimizer
        if name not in SEARCHES:
            raise self.error("search.optimizer", unknown_name("optimizer", name, SEARCHES))
        kind = SEARCHES[name]
        fields = [field.name for field in dataclasses.fields(kind)]
        settings = dict(self.config.search.model_extra or {})
        for key in settings:
            if key not in fields:
                raise self.error(f"search.{key}", unknown_key(key, [*fields, *SearchConfig.model_fields], "search"))
        settings = self.typed("search", kind, settings)
        optimizer = self.told("search", lambda: kind(**settings))
        if isinstance(optimizer, LeastSquares):
            self._check_least_squares(optimizer)
            return optimizer
        budget = self.config.search.n_evaluation
        if budget is not None and budget < optimizer.n_member:
            raise self.error(
                "search.n_evaluation",
                f"Expected at least the {optimizer.n_member} evaluations of the first population, got {budget}. Raise "
                "it, or lower search.n_member.",
            )
        return optimizer

    def _check_least_squares(self, settings: LeastSquares) -> None:
        """Whether the keys that all searches share mean something to this one."""
        search = self.config.search
        for key in _NOT_OF_LEAST_SQUARES:
            if key in search.model_fields_set:
                raise self.error(
                    f"search.{key}",
                    f"Expected it left out with least_squares, whose starts stop one by one, got "
                    f"{getattr(search, key)}. Take it out; n_generation and n_evaluation limit the search.",
                )
        n_dimension = len(self._parts(1)[3])
        least = settings.n_member * settings.price(n_dimension)
        if search.n_evaluation is not None and search.n_evaluation < least:
            raise self.error(
                "search.n_evaluation",
                f"Expected at least {least}, for {settings.n_member} starts and their Jacobians, got "
                f"{search.n_evaluation}. Raise it, or lower search.n_member.",
            )

    def typed(self, key: str, owner: type, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Settings in the types that their dataclass declares."""
        return {
            name: self.told(f"{key}.{name}", lambda name=name, value=value: typed(owner, name, value))  # type: ignore[misc]
            for name, value in settings.items()
        }

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


@dataclasses.dataclass(frozen=True)
class State:
    """One state of a plate.

    Attributes:
        name: of it.
        own: its parameters that are not common to all.
        run: the config of this state alone.
    """

    name: str
    own: tuple[str, ...]
    run: Run


def _own_of(whole: Run, state: StateConfig, run: Run) -> tuple[str, ...]:
    """Parameters of a state that are not common: those it names, and those of its own effects.

    Raises:
        InputError: if it names one that is not searched.
    """
    searched = run.searched_names()
    for name in state.own:
        if name not in searched:
            raise whole.error(
                f"measurement.{state.name}.own",
                f"Expected parameters that are searched, got '{name}'.{did_you_mean(name, searched)} There are: "
                f"{', '.join(searched) or 'none'}. Give it an interval, or correct its name.",
            )
    return tuple(name for name in searched if name in state.own or name.rpartition(".")[0] in state.effects)


def _moved(channel: Channel, frame: Frame) -> Channel:
    """A channel with its coordinates in the plate's own axes."""
    if channel.coordinate is None:
        return channel
    return dataclasses.replace(channel, coordinate=frame.on_plate(channel.coordinate))


def _parameters(kind: type[Effect], fixed: Mapping[str, Any]) -> Mapping[str, Parameter]:
    """What an effect takes with its options as given; while these cannot be used, which is said later, at all."""
    try:
        return kind(**fixed).parameters
    except (ValueError, TypeError):
        return kind.parameters


def load_run(path: Path | str, overrides: Sequence[str] = ()) -> Run:
    """Read and check a config.

    Args:
        path: a YAML file.
        overrides: "key.key=value" each, as `--set` takes them.

    Raises:
        InputError: if the file cannot be used; see `config.read_config`.
    """
    path = Path(path)
    raw, config = read_config(path, overrides)
    foreign = _foreign(config, overrides)
    if not foreign:
        return Run(path, raw, config)
    raw = raw | {"search": {key: value for key, value in raw["search"].items() if key not in foreign}}
    sentence = f"search: left out {', '.join(foreign)} of the file, which {config.search.optimizer} does not take."
    return Run(path, raw, checked(path, raw), (sentence,))


# What all searches share and this one, whose starts stop one by one, does not take.
_NOT_OF_LEAST_SQUARES = ("target", "tolerance", "stagnation")


def _foreign(config: Config, overrides: Sequence[str]) -> list[str]:
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


def load_model(path: Path | str, overrides: Sequence[str] = ()) -> PlateModel:
    """The model that a config describes; intervals become the searched parameters.

    Args:
        path: a YAML file, as `torchplate run` takes it.
        overrides: "key.key=value" each, as `--set` takes them.

    Raises:
        InputError: if the config or its measurement cannot be used.
    """
    return load_run(path, overrides).model()
