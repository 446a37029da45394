"""From two tests of one plate to what has changed between them."""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

import torch

from torchplate.diagnosis.change.after import After, against_the_next
from torchplate.diagnosis.change.comparison import Comparing
from torchplate.diagnosis.change.reference import fit_reference
from torchplate.diagnosis.change.settings import SETTINGS, ChangeSettings
from torchplate.diagnosis.change.summary import summarise
from torchplate.diagnosis.change.table import tables_changed
from torchplate.diagnosis.holdout import held_out
from torchplate.diagnosis.lines import about_peaks
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.one_thread import one_thread
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.result import Diagnosis
from torchplate.diagnosis.selection.criterion import is_explained
from torchplate.diagnosis.settings import SETTINGS as SETTINGS_OF_TESTS
from torchplate.diagnosis.settings import Fineness
from torchplate.diagnosis.target import FrfTarget
from torchplate.diagnosis.tolerance import with_tolerances
from torchplate.discrepancy import place_std
from torchplate.measurement import Imperfections, Measurement, NaturalFrequencies, noise_level
from torchplate.model import PlateModel, Searched


@dataclass(frozen=True, eq=False)
class PlateTest:
    """One test of a plate.

    Attributes:
        model: as it is believed for this test; its responses and references are the test's.
        measurement: FRFs.
        natural_frequencies: a table instead.
        tolerance: how well numbers are known: "label.parameter", "mesh.length_x" → standard deviation in SI units.
        n_average: records behind each FRF, where known.
        gain_is_unknown: the level of the FRFs carries no unit.
        imperfections: what the test is not perfect in.
        name: of the state.
    """

    __test__ = False

    model: PlateModel
    measurement: Measurement | None = None
    natural_frequencies: NaturalFrequencies | None = None
    tolerance: Mapping[str, float] = field(default_factory=dict)
    n_average: int | None = None
    gain_is_unknown: bool = False
    imperfections: Imperfections = field(default_factory=Imperfections)
    name: str = ""


@one_thread()
@torch.no_grad()
def what_changed(
    reference: PlateTest,
    after: PlateTest,
    *,
    own: Collection[str] = (),
    seed: int = 0,
    say: Callable[[str], object] = lambda _: None,
    settings: ChangeSettings = SETTINGS,
    as_given: bool = False,
) -> Diagnosis:
    """Find what has changed between two tests of one plate.

    Parameters that both models search are common to both tests, and so is what the model leaves of each mode. All is
    done with one thread, as a diagnosis is.

    Args:
        reference: the test before.
        after: the test after.
        own: common parameters that have a value of their own in each test: they change without being named.
        seed: of the choice of held-out FRFs, and of draws.
        say: is told what is being tried.
        settings: what is taken for granted.
        as_given: on the mesh as it is, with its error, which is the same in both tests.

    Raises:
        ValueError: if the tests are not both of FRFs, or both of natural frequencies, or their meshes differ.
    """
    kinds = {one.measurement is None for one in (reference, after)}
    if len(kinds) > 1:
        raise ValueError(
            "Expected FRFs in both tests, or natural frequencies in both, got one of each. Give the same kind."
        )
    if after.measurement is None:
        return tables_changed(reference, after, own=own, seed=seed, say=say, settings=settings)
    began = time.monotonic()
    targets = target_of(reference, seed), target_of(after, seed)
    comparing = comparing_of(reference, after, own, seed, say, settings, as_given, targets=targets)
    none = state = comparing.none()
    # One that is not needed beside the next makes room for another.
    for _ in range(settings.most + 1):
        if len(state.changes) == settings.most:
            break
        further = comparing.further(state)
        if further is None or len(further.changes) == len(state.changes):
            state = state if further is None else further
            break
        state = comparing.pruned(further)
        if is_explained(state.fit, comparing.after.builder.target):
            break
    if not as_given and any(change.is_of_the_section(comparing.after.model) for change in state.changes):
        say("settling on a finer mesh")
        fineness = comparing.after.builder.target.settings.meshes.settling
        finer = comparing_of(reference, after, own, seed, lambda _: None, settings, as_given, fineness, targets)
        state = comparing.settled(state, finer)
    return summarise(comparing, none, state, (reference, after), time.monotonic() - began)


def comparing_of(
    reference: PlateTest,
    after: PlateTest,
    own: Collection[str],
    seed: int,
    say: Callable[[str], object],
    settings: ChangeSettings,
    as_given: bool,
    fineness: Fineness | None = None,
    targets: tuple[FrfTarget, FrfTarget] | None = None,
) -> Comparing:
    """What looks for changes beside a fitted reference; see `what_changed`.

    With a fineness it is on another mesh than that where effects are looked for; targets are had from `target_of`.
    """
    of_reference, of_after = targets or (target_of(reference, seed), target_of(after, seed))
    say(f"reference {reference.name}".rstrip())
    before, prior = _begun(reference, of_reference, as_given, fineness)
    common = before.given.searched
    told = fit_reference(before, prior, settings)
    say(f"reference: misfit {told.fit.reduced_misfit:.3g}, beside modes of their own noise × {told.noise_scale:.3g}")
    builder, numbers = _begun(after, of_after, as_given, fineness, common)
    meshes = [(*one.mesh.cells, one.mesh.length_x, one.mesh.length_y) for one in (before, builder)]
    if meshes[0] != meshes[1]:
        raise ValueError(
            f"Expected one mesh in both tests, got {_told(meshes[0])} and {_told(meshes[1])}. Give both configs the "
            "same `mesh`."
        )
    builder = against_the_next(builder, told)
    start = {name: 0.5 * (one.low + one.high) for name, one in builder.given.searched.items()}
    found = told.fit.model.as_dict(told.fit.theta)
    theta = torch.tensor([found.get(name, middle) for name, middle in start.items()]).to(builder.given.known)
    # At the plate that the reference's was taken off at: between two plates it differs, and would stand for a change.
    model = builder.corrected(builder.given, theta, anew=True).model
    alone = [name for name in model.names if name in own or name not in told.names]
    known = replace(told.drifted(), place=place_std(builder.target.imperfections, builder.target.mesh_left))
    return Comparing(After(builder, model, known, tuple(alone)), after.model, list(numbers), say)


def _told(mesh: tuple[int, int, float, float]) -> str:
    n_x, n_y, length_x, length_y = mesh
    return f"{n_x} × {n_y} elements on {length_x:g} × {length_y:g} m"


def target_of(test: PlateTest, seed: int) -> FrfTarget:
    """What a test is held against, with its noise, whatever mesh a model is on."""
    measurement = test.measurement
    assert measurement is not None
    noise = noise_level(measurement, test.n_average)
    # Of a reference hardly anything is left but what the first lines say of a suspension, which must not hide a change.
    settings = replace(SETTINGS_OF_TESTS, wide=replace(SETTINGS_OF_TESTS.wide, as_measured=True))
    out = held_out(measurement.measured, seed)
    return FrfTarget(measurement, noise, out, test.gain_is_unknown, test.imperfections, settings=settings)


def _begun(
    test: PlateTest,
    target: FrfTarget,
    as_given: bool,
    fineness: Fineness | None,
    common: Mapping[str, Searched] | None = None,
) -> tuple[ModelBuilder, Prior]:
    """A builder against a test, and what is known of its parameters; common intervals are another test's."""
    given, prior = with_tolerances(test.model, dict(test.tolerance))
    shared = {name: one for name, one in (common or {}).items() if name in given.names}
    if shared:
        given = given.replaced(searched=given.searched | shared)
    builder = ModelBuilder(given, target, as_given, fineness, even=True)
    middle = builder.given.space.to_si(given.known.new_full((len(given.names),), 0.5))
    if not as_given:
        found = builder.corrected(builder.given, middle)
        return builder.thinned(found).expecting(found), prior
    n_mode = int((builder.given.natural_frequencies(middle, builder.given.assembly.size) <= builder.top).sum())
    target = about_peaks(target, n_mode)
    return builder.against(target.with_mesh_error(torch.zeros_like(target.frequency), 0.0, n_mode)), prior
