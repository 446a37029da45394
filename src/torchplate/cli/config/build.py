"""From a checked config to what a run needs: model, evidence, objective, optimiser."""

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchplate.cli.config.file import checked, read_config
from torchplate.cli.config.measured import Measured
from torchplate.cli.config.odd_values import odd_values
from torchplate.cli.config.searches import foreign, optimizer_of
from torchplate.cli.schema import StateConfig, unknown_key, validated, validated_states
from torchplate.discrepancy import OBJECTIVES, Evidence, ModalEvidence, Objective
from torchplate.identification import another_plate
from torchplate.measurement import NaturalFrequencies, disagreements
from torchplate.model import PlateModel, Point, coarse, extrapolate, impossible, unusual
from torchplate.nearest import did_you_mean
from torchplate.search import LeastSquares, Optimizer


@dataclasses.dataclass(frozen=True)
class Run(Measured):
    """A checked config, and all that a run makes of it; see `Recipe`."""

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

        Its mesh error, where that is to be taken off, is that of the middle of the box: `identified` takes it off anew
        where a search ends at another kind of plate.

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

    def model_as_given(self, refine: int = 1) -> PlateModel:
        """The same, its mesh error in it even where the config wants it taken off."""
        mesh, effects, known, searched = self.parts(refine)
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

    def checked_evidence(self, model: PlateModel) -> Evidence:
        """The same where the model has every channel and every mode of it.

        Raises:
            InputError: if it has not.
        """
        evidence = self.evidence(model)
        if (table := evidence.natural_frequencies) is not None and int(table.mode.max()) > model.assembly.size:
            raise self.error(
                "measurement.natural_frequencies",
                f"Expected modes up to {model.assembly.size}, as many as the mesh has, got mode "
                f"{int(table.mode.max())}. Raise mesh.refine, or leave it out.",
            )
        if evidence.measurement is not None:
            self.told("effects", model.check_channels)
        return evidence

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
        found += odd_values(self.config, model, frfs)
        if frfs is not None:
            top = float(frfs.frequency.max())
            found = [
                self.placement(frfs).remark,
                *frfs.notes,
                *self.band_remarks(),
                *self.spread_remarks(),
                *coarse(model, top),
                *found,
            ]
        if (modal := self.modal_evidence(model)) is not None:
            found = [modal.remark, *modal.modal.notes, *found]
        if frfs is not None or table is not None:
            evidence = self.evidence(model)
            apart = disagreements(model, evidence.measurement, evidence.natural_frequencies, evidence.gain_is_unknown)
            if not apart and evidence.measurement is not None:
                places = self.placement(evidence.measurement)
                apart = another_plate(model, evidence.measurement, places, evidence.gain_is_unknown)
            found += apart
        if modal is not None:
            found += disagreements(model, table=modal.table(model))
        return (*self.dropped, *found)

    def objective(self, model: PlateModel) -> Objective:
        """The function of theta that the run minimises."""
        if self.config.objective.kind not in OBJECTIVES:
            raise self.error("objective.kind", unknown_key(self.config.objective.kind, OBJECTIVES, "objective"))
        evidence = self.checked_evidence(model)
        settings = self.config.objective
        return self.told(
            "objective.kind", lambda: Objective(model, evidence, settings.kind, settings.natural_frequency_weight)
        )

    def optimizer(self) -> Optimizer[Any] | LeastSquares:
        """The search with its settings."""
        return optimizer_of(self)


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
    left = foreign(config, overrides)
    if not left:
        return Run(path, raw, config)
    raw = raw | {"search": {key: value for key, value in raw["search"].items() if key not in left}}
    sentence = f"search: left out {', '.join(left)} of the file, which {config.search.optimizer} does not take."
    return Run(path, raw, checked(path, raw), (sentence,))


def load_model(path: Path | str, overrides: Sequence[str] = ()) -> PlateModel:
    """The model that a config describes; intervals become the searched parameters.

    Args:
        path: a YAML file, as `torchplate run` takes it.
        overrides: "key.key=value" each, as `--set` takes them.

    Raises:
        InputError: if the config or its measurement cannot be used.
    """
    return load_run(path, overrides).model()
