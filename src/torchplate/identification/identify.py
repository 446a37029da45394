"""Search the intervals of a model for the values that a measurement speaks for."""

import copy
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.discrepancy import Evidence, ModalEvidence, Objective
from torchplate.identification.basis_check import TOLERANCE, confirmed, estimated, in_reduced_basis
from torchplate.identification.evaluation import compared, off_in_basis, with_search
from torchplate.identification.identify_states import identify_states
from torchplate.identification.job import Job, Settings
from torchplate.identification.mesh_error import followed
from torchplate.identification.polish import polished
from torchplate.identification.result import Result
from torchplate.identification.states import States
from torchplate.measurement import Measurement, ModalModel, NaturalFrequencies, place
from torchplate.model import PlateModel
from torchplate.search import Checkpoint, DifferentialEvolution, LeastSquares, Optimizer, Outcome, Progress


class Identified(NamedTuple):
    """The end of an identification, with what figures and reports are drawn from.

    Attributes:
        result: what was found.
        searched: the objective in the basis that was searched in.
        outcome: of the search; None where nothing is searched.
    """

    result: Result
    searched: Objective
    outcome: Outcome | None


def identify(
    model: PlateModel | States,
    measurement: Measurement | None = None,
    search: Optimizer[Any] | LeastSquares | None = None,
    seed: int = 0,
    natural_frequencies: NaturalFrequencies | Mapping[int, float] | None = None,
    objective: str = "relative_frf_norm",
    *,
    modal_model: ModalModel | ModalEvidence | None = None,
    natural_frequency_weight: float = 1.0,
    gain_is_unknown: bool = False,
    n_average: int | None = None,
    n_generation: int = 100,
    n_evaluation: int | None = None,
    tolerance: float | None = 1e-8,
    stagnation: int | None = None,
    target: float | None = None,
    n_repeat: int = 1,
    polish: bool = False,
    basis: Literal["auto", "full"] = "auto",
    precision: Literal["double", "single"] = "double",
    on_generation: Callable[[Progress], object] | None = None,
    resume: Checkpoint | None = None,
    say: Callable[[str], object] = lambda _: None,
) -> Result:
    """Search the intervals of a model, as `torchplate run` does; without one, evaluate it.

    Args:
        model: whose searched parameters are found; or one plate in several states, which bring their measurements.
            Where it is on another device, the generations are evaluated there, and all else on the CPU.
        measurement: FRFs, already cut to their band. Its channels are matched to the plate by their coordinates, else
            by node number; where they have neither, the model's responses and references stand for them.
        search: the optimiser; Differential Evolution with its defaults if left out.
        seed: of all randomness.
        natural_frequencies: a table, alone or beside FRFs; or mode number, from 1, rigid-body modes included → Hz.
        objective: a key of `OBJECTIVES`, how the gap between FRFs is measured.
        modal_model: natural frequencies with their mode shapes, instead of a table; as `ModalEvidence.of` with their
            standard deviations.
        natural_frequency_weight: factor on the error of the natural frequencies, or of the modal model, > 0.
        gain_is_unknown: the level of the FRFs carries no unit, and one factor for all of them is fitted.
        n_average: records behind each FRF, ≥ 2, with which its coherence says how noisy it is.
        n_generation: generations at most; see `Settings` for this and all up to `precision`.
        n_evaluation: evaluations at most for each search.
        tolerance: of the members' agreement.
        stagnation: generations without improvement.
        target: of the objective.
        n_repeat: independent searches.
        polish: finish by least squares.
        basis: "auto" or "full".
        precision: "double" or "single".
        on_generation: called with a `Progress` after each generation.
        resume: what `Progress.checkpoint` gave.
        say: is told what is being done, a line each.

    Raises:
        MeasurementError: if a channel is not on the plate.
        ValueError: if the measurement, or a setting, cannot be used.
        KeyError: if no objective has that name.
    """
    settings = Settings(
        n_generation, n_evaluation, tolerance, stagnation, target, seed, n_repeat, polish, basis, precision
    )
    if isinstance(model, States):
        if measurement is not None or natural_frequencies is not None or modal_model is not None:
            raise ValueError("Expected no measurement beside several states, which have theirs, got one. Leave it out.")
        optimizer = search or DifferentialEvolution()
        return identify_states(model, optimizer, settings, lambda job: job.search(on_generation), say).result
    table = natural_frequencies
    if isinstance(table, Mapping):
        table = NaturalFrequencies.from_mapping(dict(table))
    if measurement is not None:
        given, measurement = measurement, measurement.without_zeros()
        for note in measurement.notes[len(given.notes) :]:
            say(note)
    device = model.known.device
    model = model.on("cpu")
    modal = ModalEvidence.of(model, modal_model) if isinstance(modal_model, ModalModel) else modal_model
    evidence = Evidence(measurement, table, gain_is_unknown, n_average, modal)
    if measurement is not None:
        model = with_channels(model, measurement)
        model.check_channels()
    return identified(
        Objective(model, evidence, objective, natural_frequency_weight),
        search or DifferentialEvolution(),
        settings,
        lambda job: job.search(on_generation),
        resume=resume,
        say=say,
        device=device,
    ).result


@torch.no_grad()
def identified(
    objective: Objective,
    search: Optimizer[Any] | LeastSquares,
    settings: Settings,
    run: Callable[[Job], Outcome] = Job.search,
    *,
    resume: Checkpoint | None = None,
    say: Callable[[str], object] = lambda _: None,
    prepared: Callable[[Objective], object] = lambda _: None,
    device: torch.device | str = "cpu",
) -> Identified:
    """Choose a basis, search, finish, confirm, and say what was found.

    Args:
        objective: what is minimised, of the full model.
        search: how.
        settings: its budget and all that is not the optimiser's own.
        run: does the search; it may show its progress and share it among processes.
        resume: what it goes on from.
        say: is told what is being done, a line each.
        prepared: is shown the objective in the basis that is searched in, before it is evaluated; it may refuse.
        device: where the generations are evaluated.
    """
    model = objective.model
    finished = settings.polish or isinstance(search, LeastSquares)
    searched, error = in_reduced_basis(objective, settings.basis, say, settings.precision, finished)
    prepared(searched)
    if not model.names:
        result = _result(objective, searched, model.known.new_zeros(1, 0), None, search, settings, error)
        return Identified(result, searched, None)
    outcome = run(Job(searched, search, settings, resume, device))
    if settings.polish and not isinstance(search, LeastSquares):
        outcome = polished(searched, outcome, say)
    if searched is not objective:
        searched, outcome = confirmed(objective, searched, outcome, say, (error or 0.0) > TOLERANCE)
    objective, searched, outcome, off = followed(objective, searched, outcome, settings, say)
    theta = model.space.to_si(outcome.best_position[outcome.best_objective.argsort()])
    result = _result(objective, searched, theta, outcome, search, settings)
    return Identified(dataclasses.replace(result, mesh_error_moved=off), searched, outcome)


def _result(
    objective: Objective,
    searched: Objective,
    theta: Float[Tensor, "n_search n_parameter"],
    outcome: Outcome | None,
    search: Optimizer[Any] | LeastSquares,
    settings: Settings,
    error: float | None = None,
) -> Result:
    """What was found at theta, the best first; with the basis's error there, where it is known."""
    best = theta[0]
    result = with_search(compared(objective, searched, best, search, settings), searched, theta, outcome, search)
    if searched is objective:
        return result
    error, said = off_in_basis(objective, searched, best) if error is None else (error, [])
    return dataclasses.replace(
        result,
        caveats=result.caveats + said,
        basis_error=error,
        basis_error_of_population=estimated(objective, searched, outcome, error),
    )


def with_channels(model: PlateModel, measurement: Measurement) -> PlateModel:
    """The same model with a measurement's kind, responses and references.

    Args:
        model: of the plate.
        measurement: whose channels are matched to the plate by coordinates, else by node number; where it has neither,
            the model's own stand for them.

    Raises:
        MeasurementError: if a channel is not on the plate.
        ValueError: if neither says where the channels are.
    """
    twin = copy.copy(model)
    twin._modules = dict(model._modules)
    twin.kind = measurement.kind
    based = measurement.kind == "transmissibility"
    ends = measurement.response if based else (*measurement.response, *measurement.reference)
    if any(end.node or end.coordinate for end in ends):
        mesh = model.mesh
        found = place(measurement, mesh.length_x, mesh.length_y, mesh.n_x, mesh.n_y)
        twin.response = [spot.place for spot in found.response]
        twin.reference = [spot.place for spot in found.reference] or None
        return twin
    for name, own, theirs in (
        ("response", model.response, measurement.response),
        ("reference", None if based else model.reference, () if based else measurement.reference),
    ):
        if len(own or ()) != len(theirs):
            raise ValueError(
                f"Expected a place on the plate for each of the measurement's {len(theirs)} {name} channels, got none "
                f"in it and {len(own or ())} in the model. Give its channels nodes or coordinates."
            )
    return twin


@torch.no_grad()
def nominal(objective: Objective) -> Float[Tensor, " n_parameter"]:
    """The model before updating: the middle of every interval, in SI units."""
    space = objective.model.space
    return space.to_si(torch.full_like(space.low, 0.5))
