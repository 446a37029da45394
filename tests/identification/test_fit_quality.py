"""Words that a gap earns."""

import math

import pytest
import torch

import torchplate as tp
from torchplate.discrepancy import Evidence, Objective, sensitivity
from torchplate.effects import ChannelPolarity
from torchplate.identification import PlateState, States, fit_in_words
from torchplate.identification.caveats import caveats
from torchplate.identification.identify import with_channels


@pytest.mark.parametrize("gap", [1.0, 1.12, 4.0, math.nan, math.inf])
def test_a_gap_of_zero_frfs_or_more_explains_nothing(gap):
    assert "explains nothing" in fit_in_words(gap, of_frfs=True)
    assert "Do not use the values" in fit_in_words(gap, of_frfs=True)


@pytest.mark.parametrize(
    ("gap", "word", "left"), [(0.7, "poor", "49 %"), (0.2, "partial", "4 %"), (0.03, "close", "0.09 %")]
)
def test_a_smaller_gap_is_told_with_the_energy_that_it_leaves(gap, word, left):
    assert f"The fit is {word}" in fit_in_words(gap, of_frfs=True)
    assert left in fit_in_words(gap, of_frfs=True)


@pytest.mark.parametrize(("error", "word"), [(0.2, "poor"), (0.02, "partial"), (0.004, "close"), (math.nan, "poor")])
def test_natural_frequencies_have_a_scale_of_their_own(error, word):
    assert f"The fit is {word}" in fit_in_words(error, of_frfs=False)


def test_only_a_close_fit_asks_for_nothing_more():
    for gap in (0.03, 0.2, 0.7, 1.1):
        assert ("diagnose" in fit_in_words(gap, of_frfs=True)) == (gap > 0.1)


def test_no_search_says_accept_whatever_it_has_found():
    for status in tp.Status:
        assert "ccept" not in status.value


def test_a_search_that_has_settled_on_frfs_of_another_plate_is_told_as_poor(bench):
    frfs = bench.exact_frfs()
    # Turned by a quarter of a cycle: no passive plate reads like that.
    other = type(frfs)(**{**vars(frfs), "frf": 1j * frfs.frf})
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    found = tp.identify(bench.plate(["plate.youngs_modulus"]), other, search, n_generation=200, tolerance=1e-3)
    assert found.status == tp.Status.tolerance.value
    assert found.gap > 0.5
    assert "Do not use the values" in found.to_dict()["fit"]


@pytest.mark.parametrize("objective", ["log_amplitude", "relative_frf_norm"])
@pytest.mark.parametrize("gain_is_unknown", [True, False])
@pytest.mark.check
def test_a_sensor_upside_down_is_told_where_all_frfs_have_the_other_sign(bench, objective, gain_is_unknown):
    frfs = bench.exact_frfs()
    turned = type(frfs)(**{**vars(frfs), "frf": -frfs.frf})
    model = bench.plate(["plate.youngs_modulus"])
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    options = {"objective": objective, "gain_is_unknown": gain_is_unknown, "n_generation": 30}
    said = [one for one in tp.identify(model, turned, search, **options).caveats if "sign of all FRFs" in one]
    # A norm of amplitude and phase ends anywhere; decibels find the plate, whatever its sign.
    assert len(said) == 1 or objective != "log_amplitude"
    assert not [one for one in tp.identify(model, frfs, search, **options).caveats if "sign of all FRFs" in one]


@pytest.mark.parametrize("objective", ["log_amplitude", "relative_frf_norm"])
@pytest.mark.parametrize("gain_is_unknown", [True, False])
@pytest.mark.check
def test_phases_that_are_all_mirrored_are_told(bench, objective, gain_is_unknown):
    """As of exp(−iωt), on lines that are too coarse for their peaks to tell which way time runs."""
    frfs = bench.exact_frfs()
    mirrored = type(frfs)(**{**vars(frfs), "frf": frfs.frf.conj().resolve_conj()})
    model = bench.plate(["plate.youngs_modulus"])
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    options = {"objective": objective, "gain_is_unknown": gain_is_unknown, "n_generation": 30}
    said = [one for one in tp.identify(model, mirrored, search, **options).caveats if "phases of all FRFs" in one]
    # A norm of amplitude and phase ends anywhere; decibels find the plate.
    assert len(said) == 1 or objective != "log_amplitude"
    assert all("complex conjugate" in one for one in said)
    assert not [one for one in tp.identify(model, frfs, search, **options).caveats if "phases of all FRFs" in one]
    opposite = type(frfs)(**{**vars(frfs), "frf": -frfs.frf})
    assert not [one for one in tp.identify(model, opposite, search, **options).caveats if "phases of all FRFs" in one]


def test_a_model_without_an_interval_is_told_of_mirrored_phases_too(bench):
    frfs = bench.exact_frfs()
    mirrored = type(frfs)(**{**vars(frfs), "frf": frfs.frf.conj().resolve_conj()})
    (said,) = tp.identify(bench.plate(()), mirrored).caveats
    assert said.startswith("With the phases of all FRFs mirrored the gap is 0 %") or "under 0.001 %" in said


def test_frfs_beside_which_the_model_is_nothing_have_no_sign(bench):
    """A gap of 100 % with either sign: in the last digits one of them is smaller."""
    frfs = bench.exact_frfs()
    large = type(frfs)(**{**vars(frfs), "frf": -1e6 * frfs.frf})
    assert not tp.identify(bench.plate(()), large).caveats


def test_the_effect_that_is_named_for_it_turns_all_channels(bench):
    model = bench.plate(())
    frfs = bench.exact_frfs()
    effects = dict(model.effects) | {"polarity": ChannelPolarity(channels=[(None, None)])}
    other = type(model)(model.mesh, effects, bench.known | bench.truth)
    found = other.frf(other.known[:0], frfs.frequency, [4, 7], [1, 6], "accelerance")
    assert (found + frfs.frf).abs().max() < 1e-9 * frfs.frf.abs().max()


def test_a_model_without_an_interval_is_told_the_sign_too(bench):
    frfs = bench.exact_frfs()
    turned = type(frfs)(**{**vars(frfs), "frf": -frfs.frf})
    (said,) = tp.identify(bench.plate(()), turned).caveats
    assert said.startswith("With the sign of all FRFs turned the gap is ")
    assert not tp.identify(bench.plate(()), frfs).caveats


def test_a_fit_that_a_wrong_sign_explains_is_told_after_it_and_as_the_frfs_stand(bench):
    frfs = bench.exact_frfs()
    turned = type(frfs)(**{**vars(frfs), "frf": -frfs.frf})
    found = tp.identify(bench.plate(()), turned)
    assert found.misread == found.caveats[:1]
    assert " instead of 200 %: a sensor is mounted upside down" in found.misread[0]
    # What to look at first is the sign, not sides and units.
    assert found.fit.startswith("As the FRFs stand, the model explains nothing: its gap is 200 %")
    assert "first mend what is said of the FRFs" in found.fit
    assert "sides" not in found.fit
    right = tp.identify(bench.plate(()), frfs)
    assert not right.misread
    assert "mend" not in right.fit


@pytest.mark.parametrize("gap", [0.2, 0.7, 1.0])
def test_no_diagnosis_is_advised_of_frfs_that_look_misread(gap):
    assert "diagnose" in fit_in_words(gap, of_frfs=True)
    assert "diagnose" not in fit_in_words(gap, of_frfs=True, misread=True)
    assert "Do not use the values" in fit_in_words(gap, of_frfs=True, misread=True)


def changed(frfs, channel: int, factor: float, side: str = "response"):
    frf = frfs.frf.clone()
    frf.select(1 if side == "response" else 2, channel).mul_(factor)
    return type(frfs)(**{**vars(frfs), "frf": frf})


@pytest.mark.parametrize(
    ("side", "channel", "named"), [("response", 1, "[[7, null]]"), ("reference", 0, "[[null, 1]]")]
)
@pytest.mark.parametrize("searched", [[], ["plate.youngs_modulus", "wires.stiffness"]], ids=["evaluated", "searched"])
def test_one_channel_upside_down_is_told_and_what_turns_it(bench, side, channel, named, searched):
    frfs = changed(bench.exact_frfs(), channel, -1.0, side)
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    (said,) = [one for one in tp.identify(bench.plate(searched), frfs, search, n_generation=20).caveats if "-Z" in one]
    label = {"response": "Response 7w", "reference": "Reference 1w"}[side]
    assert said.startswith(f"{label} looks turned: with the other sign its gap is ")
    assert f"channels: {named}" in said


@pytest.mark.parametrize("gain_is_unknown", [True, False])
@pytest.mark.parametrize("factor", [0.7, 2.0])
@pytest.mark.check
def test_a_channel_with_a_gain_of_its_own_is_told_with_how_much(bench, factor, gain_is_unknown):
    frfs = bench.exact_frfs()
    frf = torch.cat(
        [
            frfs.frf,
            bench.plate(()).frf(torch.zeros(0, dtype=torch.float64), frfs.frequency, [10], [1, 6], "accelerance"),
        ],
        1,
    )
    more = vars(frfs) | {"response": (*frfs.response, type(frfs.response[0])(10)), "frf": frf}
    whole = type(frfs)(**more | {"measured": torch.ones(frf.shape[1:], dtype=torch.bool)})
    model = bench.plate(["plate.youngs_modulus"])
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    options = {"gain_is_unknown": gain_is_unknown, "n_generation": 20}
    (said,) = tp.identify(model, changed(whole, 1, factor), search, **options).caveats
    assert said.startswith("Response 7w looks as if it had a gain of its own: it reads ")
    read = float(said.split("it reads ")[1].split(" times")[0])
    assert read == pytest.approx(factor, rel=0.02)
    assert not tp.identify(model, whole, search, **options).caveats


def test_frfs_that_no_model_explains_have_no_channel_that_looks_turned(bench):
    frfs = bench.exact_frfs()
    other = type(frfs)(**{**vars(frfs), "frf": 1j * frfs.frf})
    assert not tp.identify(bench.plate(()), other).caveats


def test_a_channel_that_is_turned_in_one_state_is_told_with_the_state(bench):
    frfs, model = bench.exact_frfs(), bench.plate(["plate.youngs_modulus"])
    placed = type(model)(
        model.mesh, dict(model.effects), model.known_values, model.searched, [4, 7], [1, 6], "accelerance"
    )
    states = States(
        [
            PlateState.of("before", placed, Evidence(frfs)),
            PlateState.of("after", placed, Evidence(changed(frfs, 1, -1.0))),
        ]
    )
    search = tp.DifferentialEvolution(strategy="best/1/bin", n_member=10)
    found = tp.identify(states, search=search, n_generation=20)
    (said,) = found.caveats
    assert said.startswith("State 'after': Response 7w looks turned: ")
    assert found.misread == [said]


@pytest.mark.parametrize(
    ("name", "told"),
    [("loss.stiffness_loss_factor", "0.03: the optimum"), ("wires.stiffness", "4000 N/m: the optimum")],
)
def test_a_value_on_its_bound_is_told_with_its_unit_where_it_has_one(bench, name, told):
    frfs = bench.exact_frfs()
    model = with_channels(bench.plate([name]), frfs)
    objective, theta = Objective(model, Evidence(frfs)), model.space.high
    said = caveats(objective, theta, sensitivity(objective, theta))
    assert any(f"{name} ended on the upper bound of its interval, {told}" in one for one in said)
