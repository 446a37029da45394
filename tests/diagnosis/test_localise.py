"""What is hidden in a plate or its sensor chain is found where it is, and as what it is."""

import pytest
import torch

from torchplate.diagnosis.localisation.channels import channel_gaps
from torchplate.diagnosis.localisation.factor import Factor
from torchplate.diagnosis.localisation.localise import localise, missing_force
from torchplate.diagnosis.localisation.sentences import of_kind
from torchplate.effects import CATALOGUE
from torchplate.measurement.assessment.noise import noise_level

PLACE = {"x": 0.27, "y": 0.68}
RESPONSE = (3, 17)


# FRFs of the plate without what is hidden, computed once.
WITHOUT = {}


class Case:
    """FRFs of a plate with something hidden, and of the one without."""

    def __init__(self, lab, hidden=None, known=None, kind="accelerance", response=RESPONSE, n_reference=10, seed=3):
        self.frequency, self.reference = lab.lines(1.0), lab.nodes[2 : 2 + n_reference]
        self.response, self.theta = response, lab.nobody
        true = lab.plate(4e-3, {**(known or {}), **(hidden or {})}, kind=kind)
        self.model = lab.plate(4e-3, known, kind=kind)
        self.model.response, self.model.reference = list(response), list(self.reference)
        frf = true.frf(lab.nobody, self.frequency, list(response), list(self.reference))
        self.std = lab.true_std(frf, 0.01, "mixed")
        self.measured = lab.measured(
            self.frequency, frf + lab.noise_of(self.std, seed), response, self.reference, kind=kind
        )
        key = (repr(known), kind, response, self.reference)
        if key not in WITHOUT:
            WITHOUT[key] = self.model.frf(lab.nobody, self.frequency)
        self.predicted = WITHOUT[key]
        self.heldout = torch.zeros(frf.shape[1:], dtype=torch.bool)

    def located(self, **others):
        after = others.pop("after", self.predicted)
        channels = channel_gaps(self.measured, self.std, self.predicted, after, self.heldout)
        arguments = {"noise_std": self.std, "predicted": self.predicted, "model": self.model, "channels": channels}
        return localise(self.measured, theta=self.theta, **(arguments | others))


def hide(name, values, **options):
    return {"hidden": (CATALOGUE[name](**options), values)}


def highest(field):
    row, column = divmod(int(field.index.argmax()), len(field.x))
    return float(field.x[column]), float(field.y[row])


GROUNDED = {
    "point_mass": ("mass", {"mass": 0.008}, "kg"),
    "ground_spring": ("stiffness", {"stiffness": 3000.0}, "N/m"),
    "ground_dashpot": ("damping", {"viscous_damping": 1.0}, "N s/m"),
}


@pytest.mark.parametrize(("name", "response"), [("point_mass", RESPONSE), *((name, RESPONSE[:1]) for name in GROUNDED)])
@pytest.mark.check
def test_what_is_at_a_place_is_found_there_and_told_by_its_kind(lab, name, response):
    kind, value, unit = GROUNDED[name]
    found = Case(lab, hide(name, PLACE | value), response=response).located()
    assert found.map is not None
    # A grid of twelfths, and half wavelengths of a fifth of the plate.
    assert highest(found.map) == pytest.approx((0.27, 0.68), abs=0.1)
    rest = {"mass", "stiffness", "damping"} - {kind}
    assert found.kind[kind] > 0.95
    assert max(found.kind[other] for other in rest) < 0.3
    assert found.kind["sensor chain"] < 0.3
    said = [sentence for sentence in found.sentences if sentence.startswith("A force at")]
    assert len(said) == 1
    x, y = (float(word) for word in said[0][said[0].index("(") + 1 : said[0].index(")")].split(","))
    assert (x, y) == pytest.approx((0.27, 0.68), abs=0.05)
    size = float(said[0].split("about ")[1].split(f" {unit})")[0])
    # The place is good to a fiftieth of the plate, over which the deflection changes by some per cent.
    assert size == pytest.approx(next(iter(value.values())), rel=0.15)


def test_a_mass_that_shifts_resonances_by_many_widths_is_found(lab):
    case = Case(lab, hide("point_mass", PLACE | {"mass": 0.2}))
    found = case.located()
    # More than one: the peaks do not even overlap.
    assert found.channels[0].before > 1
    assert found.kind["mass"] > 0.85
    assert highest(found.map) == pytest.approx((0.27, 0.68), abs=0.1)


@pytest.mark.parametrize("kind", ["receptance", "mobility"])
@pytest.mark.check
def test_the_kind_of_frf_changes_nothing(lab, kind):
    found = Case(lab, hide("point_mass", PLACE | {"mass": 0.008}), kind=kind).located()
    assert found.kind["mass"] > 0.95
    assert highest(found.map) == pytest.approx((0.27, 0.68), abs=0.1)


@pytest.mark.check
def test_a_sensor_chain_that_the_model_knows_turns_no_mass_into_a_dashpot(lab):
    known = {
        "gain": (CATALOGUE["sensor_gain"](), {"gain": 2.5}),
        "late": (CATALOGUE["time_delay"](), {"delay": 1e-3}),
        "upside down": (CATALOGUE["channel_polarity"](channels=[(3, 36)]), {}),
    }
    found = Case(lab, hide("point_mass", PLACE | {"mass": 0.008}), known).located()
    assert found.kind["mass"] > 0.95
    size = next(sentence for sentence in found.sentences if "mass-like" in sentence).split("about ")[1].split(" kg")[0]
    assert float(size) == pytest.approx(0.008, rel=0.15)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("sensor_gain", {"gain": 1.08}, "a gain of 1.08 would"),
        ("time_delay", {"delay": 2e-4}, "a delay of 0.2 ms would"),
        ("time_delay", {"delay": -2.5e-3}, "a delay of -2.5 ms would"),
    ],
)
@pytest.mark.check
def test_what_all_channels_share_is_the_sensor_chain(lab, name, value, said):
    found = Case(lab, hide(name, value)).located()
    assert found.kind["sensor chain"] > 0.98
    assert max(found.kind[kind] for kind in ("stiffness", "damping", "mass", "place")) < 0.5
    assert any(said in sentence and "sensor chain" in sentence for sentence in found.sentences)
    assert not any("A force at" in sentence for sentence in found.sentences)


@pytest.mark.check
def test_a_gain_and_a_delay_are_found_together(lab):
    hidden = hide("sensor_gain", {"gain": 0.8}) | {"late": (CATALOGUE["time_delay"](), {"delay": 3e-4})}
    found = Case(lab, hidden).located()
    assert found.kind["sensor chain"] > 0.98
    assert any("a delay of 0.3 ms and a gain of 0.8" in sentence for sentence in found.sentences)


@pytest.mark.parametrize(("channels", "said"), [([(3, 52)], "on 3w/52w alone"), ([(17, None)], "all of response 17w")])
@pytest.mark.check
def test_a_channel_of_the_wrong_sign_is_named(lab, channels, said):
    found = Case(lab, hide("channel_polarity", {}, channels=channels)).located()
    assert found.kind["single channel"] > 0.98
    assert any(said in sentence and "wrong sign" in sentence for sentence in found.sentences)
    worst = found.channels[0]
    assert worst.before == pytest.approx(2.0, abs=0.02)
    if channels == [(3, 52)]:
        assert (worst.response, worst.reference) == ("3w", "52w")
    assert not any("A force at" in sentence for sentence in found.sentences)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.check)])
def test_noise_alone_claims_no_place(lab, seed):
    case = Case(lab, seed=seed)
    found = case.located(noise_std=noise_level(case.measured).std)
    assert found.bands == ()
    assert found.map is None
    assert found.kind == {}
    assert len(found.sentences) == 1
    assert found.sentences[0].startswith("No band, channel or place stands out")


def test_what_is_spread_over_the_plate_is_not_said_to_be_at_a_place(lab):
    case = Case(lab, n_reference=10)
    softer = lab.plate(4e-3)
    softer.known[softer.known == 2.05e11] *= 1.002
    predicted = softer.frf(lab.nobody, case.frequency, list(RESPONSE), list(case.reference))
    found = case.located(predicted=predicted)
    assert found.kind["place"] < 0.85
    assert "spread over the plate" in " ".join(found.sentences)


def test_bands_hold_the_misfit_and_stand_where_it_is(lab):
    case = Case(lab)
    # Half a signal too much around two of the resonances.
    wrong = torch.ones_like(case.frequency)
    places = ((286.0, 300.0), (340.0, 355.0))
    for low, high in places:
        wrong[(case.frequency >= low) & (case.frequency <= high)] = 1.5
    found = case.located(predicted=case.predicted * wrong[:, None, None])
    # The moving mean over three lines may take in one more.
    inside = [[low - 1 <= band.low and band.high <= high + 1 for low, high in places] for band in found.bands]
    assert all(any(one) for one in inside)
    assert all(any(column) for column in zip(*inside, strict=True))
    assert [band.share for band in found.bands] == sorted((band.share for band in found.bands), reverse=True)
    assert sum(band.share for band in found.bands) == pytest.approx(1.0, abs=0.2)
    assert found.sentences[0].endswith("Hz.")
    assert f"{found.bands[0].low:.0f}-{found.bands[0].high:.0f} Hz" in found.sentences[0]


@pytest.mark.check
def test_channels_carry_their_gaps_before_and_after(lab):
    case = Case(lab, hide("sensor_gain", {"gain": 1.1}))
    case.heldout[1, 4] = True
    after = case.predicted * 1.05
    found = channel_gaps(case.measured, case.std, case.predicted, after, case.heldout)
    assert len(found) == 20
    assert [one.before for one in found] == sorted((one.before for one in found), reverse=True)
    for one in found:
        assert one.before == pytest.approx(0.1 / 1.1, abs=0.004)
        assert one.after == pytest.approx(0.05 / 1.1, abs=0.004)
        assert one.floor == pytest.approx(0.01, rel=0.02)
        assert one.heldout == ((one.response, one.reference) == ("17w", f"{case.reference[4]}w"))
    assert case.located(after=after).channels[0].after < 0.06


@pytest.mark.check
def test_exchanged_channels_that_the_model_knows_leave_no_map(lab):
    # FRFs to other places would have to know of both.
    known = {"crossed": (CATALOGUE["channel_swap"](channels=[(3, None), (17, None)]), {})}
    case = Case(lab, hide("point_mass", PLACE | {"mass": 0.008}), known)
    found = case.located()
    assert found.map is None
    assert len(found.bands) > 0
    assert missing_force(case.measured, case.std, case.predicted, case.model, case.theta) is None
    plain = Case(lab, hide("point_mass", PLACE | {"mass": 0.008}))
    force = missing_force(plain.measured, plain.std, plain.predicted, plain.model, plain.theta)
    assert force is not None
    assert force.place == pytest.approx((0.27, 0.68), abs=0.03)


@pytest.mark.parametrize("n_reference", [1, 2])
def test_one_or_two_frfs_say_nothing_of_a_place(lab, n_reference):
    case = Case(lab, hide("point_mass", PLACE | {"mass": 0.05}), response=(3,), n_reference=n_reference)
    found = case.located()
    assert found.map is None
    assert "mass" not in found.kind
    assert found.bands
    assert not any("A force at" in sentence for sentence in found.sentences)


@pytest.mark.check
def test_what_was_not_measured_counts_nowhere(lab):
    case = Case(lab, hide("point_mass", PLACE | {"mass": 0.008}))
    pairs = torch.ones(2, 10, dtype=torch.bool)
    pairs[0, 3] = pairs[1, 7] = False
    case.measured = lab.measured(case.frequency, case.measured.frf, case.response, case.reference, measured=pairs)
    found = case.located()
    assert len(found.channels) == 18
    assert found.kind["mass"] > 0.95
    assert highest(found.map) == pytest.approx((0.27, 0.68), abs=0.1)


def test_where_no_kind_explains_much_no_force_is_denied_that_may_be_free_at_every_line():
    # The table beside it has such a force, with next to all of the misfit.
    nothing = Factor(0.0, 1.0, 0.0, "", (0.0, 0.0))
    (sentence,) = of_kind(None, nothing, nothing)
    assert sentence.startswith("No spring, dashpot or mass at one place, no gain")
