"""Tables of natural frequencies: what is named, how surely, and what a table cannot tell."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence

import pytest
import torch

import torchplate as tp
from torchplate.diagnosis.table import diagnose_table
from torchplate.diagnosis.table.comparison import Comparing
from torchplate.diagnosis.table.evidence import TableEvidence
from torchplate.diagnosis.table.hypotheses import visible
from torchplate.diagnosis.table.plates import Plates
from torchplate.diagnosis.table.refit import Minimum, Problem, together
from torchplate.diagnosis.table.settings import SETTINGS
from torchplate.effects import CATALOGUE
from torchplate.measurement import NaturalFrequencies
from torchplate.measurement.natural_frequencies import printed_unit
from torchplate.model import PlateModel, Searched
from torchplate.model.discretisation.fine_mesh import SparseModel
from torchplate.plate import Mesh

YOUNG = {"plate.youngs_modulus": Searched(1.8e11, 2.4e11)}
NOBODY = torch.zeros(0, dtype=torch.float64)
# 4.7 kg; not square.
NUMBERS = {"plate.poisson_ratio": 0.3, "plate.density": 7850.0, "plate.thickness": 0.003}
SIDES = (0.55, 0.363)
# Few pairs, where nothing hangs on them.
QUICK = dataclasses.replace(SETTINGS, n_pair=2, n_pair_beside=2, n_start=4, n_onward=2)

Hidden = tuple[str, tuple[tuple[str, float], ...]]


def plate(searched: Mapping[str, Searched] | None = None, refine: int = 1, *hidden: Hidden) -> PlateModel:
    """A free steel plate and what is hidden in it; as given, on a mesh whose error is taken off."""
    effects, known = {"plate": CATALOGUE["plate"]()}, NUMBERS | {"plate.youngs_modulus": 2.1e11}
    for k, (name, values) in enumerate(hidden):
        effects[f"hidden {k}"] = CATALOGUE[name]()
        known |= {f"hidden {k}.{key}": value for key, value in values}
    known = {key: value for key, value in known.items() if key not in (searched or {})}
    return PlateModel(Mesh(*SIDES, 10, 10, refine, extrapolate=refine == 1), effects, known, searched)


def hide(name: str, **values: float) -> Hidden:
    """An effect and its numbers."""
    return name, tuple(values.items())


@functools.cache
def exact(n: int, *hidden: Hidden) -> torch.Tensor:
    """The first flexible natural frequencies, on a mesh four times as fine, whose error is below 0.1 % [Hz]."""
    with torch.no_grad():
        modes = SparseModel(plate(None, 4, *hidden), NOBODY).modes(n + 3)
    return modes.frequency[3 : n + 3]


def table(n: int, *hidden: Hidden, scatter: float = 0.0, seed: int = 0, decimals: int = 2) -> NaturalFrequencies:
    """What a test would print of it."""
    noise = torch.randn(n, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    found = (exact(n, *hidden) * (1 + scatter * noise)).round(decimals=decimals)
    return NaturalFrequencies(torch.arange(4, n + 4), found.sort().values)


def names(found: tp.diagnosis.Diagnosis) -> set[str]:
    """Everything that may be what is missing, a finer mesh aside."""
    every = [one for one in found.effects if one.name != "mesh_discretisation"]
    return {name for one in every for name in (one.name, *one.equivalent)}


@functools.cache
def massive() -> tp.diagnosis.Diagnosis:
    """150 g on the plate, 14 frequencies that scatter by 0.1 %."""
    hidden = hide("point_mass", x=0.23, y=0.31, mass=0.15)
    return diagnose_table(plate(YOUNG), table(14, hidden, scatter=1e-3), settings=QUICK)


@pytest.mark.check
def test_a_mass_of_three_percent_of_the_plate_is_named_from_fourteen_frequencies():
    found = massive()
    assert found.verdict == "explained"
    assert "point_mass" in names(found)


@pytest.mark.check
def test_an_interval_holds_the_hidden_number_and_its_mirror_images():
    one = next(one for one in massive().effects if one.name == "point_mass")
    mass = one.parameters["mass"]
    # Five standard deviations of a Gaussian: the claim is that the number is right, not how surely.
    assert abs(mass.value - 0.15) < 5 * mass.std
    assert mass.low < mass.value < mass.high
    # Frequencies of a free plate do not know its sides from each other.
    assert one.parameters["x"].low < 0.3 < 0.7 < one.parameters["x"].high


@pytest.mark.check
def test_the_diagnosis_says_what_scatter_it_assumes():
    assert any("0.1 %" in sentence for sentence in massive().remarks)


@pytest.mark.check
def test_sixty_grams_on_ten_exact_frequencies_are_not_left_unexplained():
    hidden = hide("point_mass", x=0.23, y=0.31, mass=0.06)
    found = diagnose_table(plate(YOUNG), table(10, hidden, decimals=4), settings=QUICK)
    assert found.verdict != "unexplained"
    assert "point_mass" in names(found)


@pytest.mark.check
def test_nothing_is_named_where_nothing_is_hidden():
    found = diagnose_table(plate(YOUNG), table(12, scatter=1e-3, seed=3), settings=QUICK)
    assert found.verdict == "consistent"
    assert not names(found)


@pytest.mark.check
def test_what_scatter_leaves_of_a_right_model_is_seldom_called_unexplained():
    model, std = plate(YOUNG), 1e-3 * exact(12)
    seen = []
    for seed in range(40):
        drawn = table(12, scatter=1e-3, seed=seed, decimals=6)
        evidence = TableEvidence.of(dataclasses.replace(drawn, std=std), SETTINGS)
        if not seen:
            plates = Plates.corrected(model, evidence, SETTINGS)
            Comparing(plates, {}, SETTINGS, lambda _: None).baseline()
            natural = plates.reduced(plates.model)
        with torch.no_grad():
            problem = Problem(natural, evidence, {}, SETTINGS)
            found = problem.minima(torch.full((1, 1), 0.5, dtype=torch.float64))[0]
        seen.append(found.chi_square <= evidence.limit(found.n_effective, SETTINGS.level))
    # One in a hundred is expected beyond the limit; 3 of 40 are so with probability 0.007.
    assert sum(seen) >= 38


@pytest.mark.check
def test_what_has_as_many_free_numbers_as_a_table_is_no_hypothesis_of_it():
    """Seven numbers of a rib and a modulus fit any six frequencies, whatever is missing."""
    drawn = table(6, hide("orthotropy", young_ratio=0.8, shear_factor=1.2), scatter=1e-3)
    plates = Plates.corrected(plate(YOUNG), TableEvidence.of(drawn, SETTINGS), SETTINGS)
    comparing = Comparing(plates, {}, QUICK, lambda _: None)
    found = comparing.singles(*comparing.baseline())
    tried = {name for one in found.weighed for name in one.names}
    assert {"orthotropy", "point_mass", "poisson_ratio"} <= tried
    assert not tried & {"rib", "absorber"}


@pytest.mark.check
def test_a_pair_is_found_where_no_single_effect_does():
    hidden = (hide("point_mass", x=0.23, y=0.31, mass=0.2), hide("aspect_ratio", ratio=1.03))
    found = diagnose_table(plate(YOUNG), table(16, *hidden, scatter=3e-4))
    assert found.verdict == "explained"
    assert {"point_mass", "aspect_ratio"} <= names(found)


@functools.cache
def evaluated() -> Plates:
    evidence = TableEvidence.of(table(12, scatter=1e-3), SETTINGS)
    return Plates(plate(YOUNG), evidence, "corrected", SETTINGS, 100)


@pytest.mark.parametrize("name", sorted(name for name, one in CATALOGUE.items() if one.moves_natural_frequencies()))
def test_every_effect_changes_natural_frequencies_as_its_slope_says(name):
    plates = evaluated()
    middle = plates.model.known.new_full((1,), 0.43)
    every = [one for one in visible(plates, plates.model.space.to_si(middle)) if one.name == name]
    if not every:
        # The plate itself, and what is no candidate of a table.
        assert name in (
            "plate",
            "support_spring",
            "support_asymmetry",
            "thickness_field",
            "field",
            "grain_angle",
        )
        return
    natural = plates.reduced(plates.with_effects([every[0]], ["more"]))
    # Away from the lines between elements, where what runs along one has a kink.
    spread = 0.1 + 0.8 * torch.rand(2, natural.n_parameter, generator=torch.Generator().manual_seed(4)).double()
    step = 1e-5 * torch.eye(natural.n_parameter, dtype=torch.float64)[:, None]
    above, below = natural.frequency(torch.stack([spread + step, spread - step]))
    # The slope's own step of 1e-6 times the curvature of what moves along the plate [Hz].
    assert natural.slope(spread).movedim(-1, 0) == pytest.approx((above - below) / 2e-5, rel=1e-3, abs=1e-2)


@pytest.mark.parametrize(
    ("parts", "held"),
    [
        # Likelihood and part of the box of each: beside one that holds all, others of its height change nothing.
        ([(1.0, 1.0), (1.0, 1.0), (1.0, 1.0)], 1.0),
        # What they hold together is a mean over the prior.
        ([(1.0, 1.0), (0.5, 1.0)], 0.75),
        # Narrow ones add up.
        ([(1.0, 0.1), (0.5, 0.2)], 0.2),
        ([(3.0, 0.04)], 0.12),
    ],
)
def test_minima_hold_no_more_of_the_prior_than_there_is(parts, held):
    nothing = torch.zeros(0, dtype=torch.float64)

    def minimum(likelihood: float, part: float) -> Minimum:
        peak = -2 * math.log(likelihood)
        evidence = peak - 2 * math.log(part)
        square = nothing[:, None] @ nothing[None]
        return Minimum(nothing, 1.0, 0.0, square, nothing > 0, nothing[None], (), peak, evidence, 0.0, nothing)

    assert together([minimum(*part) for part in parts]) == pytest.approx(-2 * math.log(held), rel=1e-12)


@pytest.mark.check
def test_damping_and_the_sensor_chain_are_no_hypotheses_of_a_table():
    seen = {row.name for row in massive().scores[0]}
    blind = {name for name, kind in CATALOGUE.items() if not kind.moves_natural_frequencies()}
    assert {"sensor_gain", "time_delay", "hysteretic_damping", "damping_patch", "ground_dashpot"} <= blind
    assert not seen & blind


@pytest.mark.check
def test_what_scales_all_frequencies_cannot_be_told_from_the_modulus():
    rows = {row.name: row for row in massive().scores[0]}
    for name in ("density", "thickness"):
        assert "cannot see" in rows[name].remark


@pytest.mark.check
def test_confidence_is_high_only_if_no_parameter_wants_to_leave_its_prior():
    # More than the prior of a mass holds: a tenth of the plate.
    hidden = hide("point_mass", x=0.23, y=0.31, mass=0.9)
    found = diagnose_table(plate(YOUNG), table(14, hidden, scatter=1e-3), settings=QUICK)
    assert found.effects
    for one in found.effects:
        pressed = [f"{one.label}.{key} sits on the edge" for key in one.parameters]
        if any(sentence.startswith(start) for sentence in found.remarks for start in pressed) and not one.equivalent:
            assert one.confidence <= 0.9


@pytest.mark.parametrize(
    ("printed", "units"), [((48.0, 93.8, 337.3), (0.1, 0.1, 0.1)), ((48.1, 114, 1230), (0.1, 1, 10))]
)
def test_rounding_follows_the_printed_decimals_or_digits(printed: Sequence[float], units: Sequence[float]):
    values = torch.tensor(printed, dtype=torch.float64)
    assert printed_unit(NaturalFrequencies(torch.arange(1, 4), values)).tolist() == pytest.approx(units)


def test_an_unknown_scale_of_the_scatter_costs_less_than_its_square():
    told = TableEvidence.of(dataclasses.replace(table(12), std=torch.ones(12, dtype=torch.float64)), SETTINGS)
    assumed = TableEvidence.of(table(12), SETTINGS)
    for one in (told, assumed):
        cost = one.minus_two_log_likelihood(36.0) - one.minus_two_log_likelihood(12.0)
        expected = (one.freedom + 12) * math.log((one.freedom + 36) / (one.freedom + 12))
        assert cost == pytest.approx(expected)
        assert cost < 24.0
    assert assumed.limit(1.0, 0.99) > told.limit(1.0, 0.99)
