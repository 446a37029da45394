"""Verdicts and intervals of the blind benchmark on diagnoses made by hand."""

import json
from pathlib import Path

import pytest
import torch

from blind.place import size_error, which_is_right
from blind.score import Score, markdown, report, tables, verdict, wilson
from blind.suite import chosen, run_case
from blind.twins import right, twins
from torchplate.effects import CATALOGUE
from torchplate.model import PlateModel
from torchplate.plate import Mesh


def truth(kind="one", known=(), **hidden):
    entries = [{"effect": name, "options": {}, "parameters": p} for name, p in hidden.items()]
    return {
        "name": "000", "kind": kind, "hidden": entries, "noise": 0.01, "shows": [1.0], "youngs_modulus": 2e11,
        "young_is_seen": True, "sides": [0.48, 0.48], "grid": [10, 10],
        "response": [5], "reference": [3, 61, 80], "n_frf": 6, "n_line": 400, "known": list(known),
        "stated": {"density": 7860.0, "thickness": 0.0027, "poisson_ratio": 0.3}, "extra": {},
    }  # fmt: skip


def answer(name, *equivalent, confidence=0.9, **parameters):
    values = {key: {"value": value, "std": 0.0, "unit": "-"} for key, value in parameters.items()}
    return {"name": name, "equivalent": list(equivalent), "confidence": confidence, "parameters": values}


def record(case, word, *answers, young=2.002e11):
    gap = {"heldout_final": 0.011, "noise_floor": 0.01}
    diagnosis = {"verdict": word, "effects": list(answers), "gap": gap}
    return {"index": 0, "truth": case, "diagnosis": diagnosis, "youngs_modulus": young, "seconds": 5.0}


MASS = {"x": 0.2, "y": 0.7, "mass": 0.05}


def test_the_right_name_is_right_and_its_numbers_are_measured():
    found = verdict(record(truth(point_mass=MASS), "explained", answer("point_mass", x=0.23, y=0.66, mass=0.04)))
    assert found.right
    assert found.place == pytest.approx((0.05,))
    assert found.size[0][1] == pytest.approx(0.2)
    assert found.young == pytest.approx(0.001)
    assert found.gap == pytest.approx(1.1)


@pytest.mark.parametrize(
    ("word", "answers"),
    [
        ("explained", [answer("ground_spring")]),
        ("explained", [answer("point_mass", "ground_spring")]),
        ("explained", [answer("point_mass"), answer("time_delay")]),
        ("partly_explained", [answer("point_mass")]),
        ("consistent", []),
    ],
    ids=["another", "a stranger beside it", "one too many", "not explained", "nothing"],
)
def test_everything_else_is_wrong(word, answers):
    assert not verdict(record(truth(point_mass=MASS), word, *answers)).right


def test_the_supports_count_up_to_what_the_searched_spring_takes():
    hidden = {"factor_1": 0.5, "factor_2": 1.0, "factor_3": 1.0}
    assert size_error("support_asymmetry", hidden, {"factor_2": 2.0, "factor_3": 2.0}) == pytest.approx(0)
    # Where the spring is known, all factors are named, and count as they are.
    doubled = {"factor_1": 1.0, "factor_2": 2.0, "factor_3": 2.0}
    assert size_error("support_asymmetry", hidden, doubled) == pytest.approx(3.0)
    alike = size_error("support_asymmetry", hidden, {"factor_2": 1.0, "factor_3": 1.0})
    assert alike == pytest.approx(0.8165, rel=1e-3)


def test_a_finer_mesh_is_never_held_against_an_answer():
    mesh = answer("mesh_discretisation")
    assert verdict(record(truth(point_mass=MASS), "explained", mesh, answer("point_mass", **MASS))).right
    assert verdict(record(truth("none"), "explained", mesh)).right
    assert verdict(record(truth(mesh_discretisation={}), "explained", mesh)).right
    assert not verdict(record(truth("none"), "explained", answer("sensor_gain"))).right


def test_exact_twins_must_be_named_together_unless_a_std_parts_them():
    free, weighed = truth(density={"value": 8200.0}), truth(density={"value": 8200.0}, known=["thickness"])
    both = answer("sensor_gain", "density")
    assert right("density", both, free)
    assert right("density", both, weighed)
    assert not right("density", answer("sensor_gain"), free)
    assert right("density", answer("thickness", "density"), free)
    assert not right("density", answer("thickness", "density"), weighed)
    assert verdict(record(free, "explained", answer("sensor_gain"))).twin_as_sure


def test_one_tighter_wire_is_a_spring_to_the_ground_and_a_slack_one_is_not():
    for factors, alike in (((1.0, 1.6), True), ((1.0, 0.6), False), ((1.5, 1.6), False)):
        hidden = {f"factor_{index + 1}": one for index, one in enumerate(factors)}
        assert ("ground_spring" in twins("support_asymmetry", truth(support_asymmetry=hidden))) == alike
    spring = truth(ground_spring={"x": 0.2, "y": 0.7, "stiffness": 300.0})
    assert "support_asymmetry" not in twins("ground_spring", spring)


def test_orthotropy_is_a_stretch_only_without_a_shear_factor():
    assert "aspect_ratio" in twins("orthotropy", truth(orthotropy={"young_ratio": 1.2, "shear_factor": 1.0}))
    assert "aspect_ratio" not in twins("orthotropy", truth(orthotropy={"young_ratio": 1.2, "shear_factor": 1.1}))


@pytest.mark.parametrize(
    ("named", "good"),
    [
        ({"channels": [[None, 61], [None, 3]]}, True),
        ({"channels": [[None, [0.5, 0.5]], [None, [0.2, 0.0]]]}, True),
        ({"channels": [[5, 3], [5, 61]]}, True),
        ({"channels": [3, 61]}, True),
        ({"channels": [[None, 3], [None, 80]]}, False),
        ({}, False),
    ],
    ids=["turned round", "by place", "as pairs", "by label", "another", "none"],
)
def test_the_right_channels_are_the_same_two_in_any_words(named, good):
    true = {"channels": [[None, 3], [None, 61]]}
    assert which_is_right("channel_swap", true, {"effect": "channel_swap"} | named, truth()) is good


def test_two_effects_need_both_and_no_third():
    case = truth("two", point_mass=MASS, time_delay={"delay": 1e-4})
    mass, delay = answer("point_mass", **MASS), answer("time_delay", delay=1e-4)
    assert verdict(record(case, "explained", delay, mass)).right
    assert not verdict(record(case, "explained", mass)).right
    assert verdict(record(case, "explained", mass)).found == ("point_mass",)
    assert not verdict(record(case, "explained", mass, delay, answer("edge_spring"))).right


@pytest.mark.parametrize(("word", "good"), [("unexplained", True), ("partly_explained", True), ("explained", False)])
def test_beyond_the_catalogue_nothing_explains(word, good):
    assert verdict(record(truth("beyond", hinge={}), word)).right is good


def test_wilson_gives_the_interval_of_the_books():
    # 8 of 10 at 90 %: centre (0.8 + z²/20) / (1 + z²/10), z = 1.645.
    assert wilson(8, 10) == pytest.approx((0.541, 0.931), abs=2e-3)
    assert wilson(0, 24)[0] == 0.0
    assert wilson(24, 24)[1] == 1.0


def test_calibration_and_brier_count_every_named_effect():
    records = [
        record(truth(point_mass=MASS), "explained", answer("point_mass", confidence=0.96, **MASS)),
        record(truth(point_mass=MASS), "explained", answer("time_delay", confidence=0.6, delay=1.0)),
    ]
    rows, brier = Score(records).calibration()
    assert [(n, rate) for _, n, _, rate in rows] == [(1, 0.0), (1, 1.0)]
    assert brier == pytest.approx((0.04**2 + 0.6**2) / 2)


def with_seen(case, *words, stratum="workshop"):
    return case | {"detectable": list(words), "stratum": stratum}


@pytest.mark.parametrize(
    ("seen", "word", "answers", "good"),
    [
        ("no", "consistent", [], True),
        ("no", "explained", [answer("point_mass")], False),
        ("either", "consistent", [], True),
        ("either", "explained", [answer("point_mass")], True),
        ("either", "explained", [answer("time_delay")], False),
        ("yes", "consistent", [], False),
    ],
)
def test_what_cannot_be_seen_is_right_only_if_nobody_names_it(seen, word, answers, good):
    assert verdict(record(with_seen(truth(point_mass=MASS), seen), word, *answers)).right is good


def test_an_interval_holds_the_truth_by_its_ends_else_by_its_std():
    case = truth(point_mass=MASS)
    found = answer("point_mass", x=0.21, y=0.6, mass=0.04)
    found["parameters"]["x"] |= {"low": 0.19, "high": 0.22, "std": 1e-6}
    found["parameters"]["y"] |= {"std": 0.05}
    found["parameters"]["mass"] |= {"std": 0.01}
    # y is two standard deviations off, the mass one; 1.645 hold 90 %.
    covered = {name: inside for _, name, inside in verdict(record(case, "explained", found)).covered}
    assert covered == {"x": True, "y": False, "mass": True}
    oblong = truth(stiffness_loss={"x": 0.2, "y": 0.7, "size": 0.2, "factor": 0.5, "aspect": 2.0})
    patch = answer("stiffness_loss", x=0.2, y=0.7, size=0.3, factor=0.5)
    for entry in patch["parameters"].values():
        entry["std"] = 0.01
    assert {name for _, name, _ in verdict(record(oblong, "explained", patch)).covered} == {"x", "y"}


def test_the_rows_of_a_stratum_part_what_shows_from_what_does_not():
    mass = truth(point_mass=MASS)
    named = answer("point_mass", **MASS)
    records = [
        record(with_seen(mass, "yes"), "explained", named),
        record(with_seen(mass, "no"), "consistent"),
        record(with_seen(mass, "no"), "explained", answer("time_delay")),
        record(with_seen(truth("none")), "explained", answer("time_delay")),
    ]
    rows = {name.strip(): (count, n) for name, count, n in Score(records).rates()}
    assert rows["one effect, named right (of the detectable)"] == (1, 1)
    assert rows["one effect, undetectable, not named"] == (1, 2)
    assert rows["a false name on nothing hidden"] == (1, 1)
    assert rows["a false name, all but beyond"] == (2, 4)


def fake(config: Path, out: Path) -> None:
    """A diagnosis that always says point_mass."""
    out.mkdir()
    gap = {"heldout_final": 0.011, "noise_floor": 0.01}
    found = answer("point_mass", **MASS)
    (out / "diagnosis.json").write_text(
        json.dumps({"verdict": "explained", "effects": [found], "gap": gap, "model": "model.yaml"})
    )
    (out / "model.yaml").write_text(config.read_text())


def crash(config: Path, out: Path) -> None:
    raise RuntimeError("no such luck")


@pytest.mark.check
def test_a_case_is_run_and_recorded_and_a_crash_is_one_more_wrong_answer(tmp_path):
    index = chosen("0:", "point_mass")[0]
    records = [run_case("test", index, tmp_path / name, how) for name, how in (("a", fake), ("b", crash))]
    json.dumps(records)
    assert records[0]["diagnosis"]["effects"][0]["name"] == "point_mass"
    assert records[0]["youngs_modulus"] is None  # still an interval in what the fake wrote
    assert records[1]["error"] == "RuntimeError: no such luck"
    assert not verdict(records[1]).right
    for table in tables(Score(records)):
        assert markdown(table).startswith("###")


@pytest.mark.parametrize("stratum", [pytest.param("workshop", marks=pytest.mark.check), "tables"])
def test_a_case_of_another_stratum_is_run_and_recorded(stratum, tmp_path):
    index = chosen("0:", "point_mass", stratum)[0]
    found = run_case("test", index, tmp_path, fake, stratum, "spectral")
    json.dumps(found)
    assert found["diagnosis"], found.get("error")
    assert (found["stratum"], found["truth"]["by"]) == (stratum, "spectral")
    assert found["truth"]["detectable"]
    (tmp_path / "results.jsonl").write_text(json.dumps(found) + "\n")
    report(tmp_path)
    assert f"{stratum}: rates" in (tmp_path / "table.md").read_text()


@pytest.mark.check
def test_where_springs_and_masses_are_free_a_heavier_plate_is_a_smaller_gain():
    # Not even a spring or a mass beside the plate gives the level a scale, as long as its own number is looked for.
    lines = torch.linspace(5.0, 300.0, 40, dtype=torch.float64)
    found = []
    for scale in (1.0, 1.17):
        effects = {
            "plate": CATALOGUE["plate"](), "wires": CATALOGUE["support_spring"](nodes=[2, 10]),
            "edge": CATALOGUE["edge_spring"](edge="y1"), "lump": CATALOGUE["point_mass"](),
            "loss": CATALOGUE["hysteretic_damping"](), "patch": CATALOGUE["stiffness_loss"](),
        }  # fmt: skip
        scaled = {
            "plate.youngs_modulus": 2e11, "plate.density": 7800.0, "wires.stiffness": 900.0,
            "wires.viscous_damping": 0.7, "edge.stiffness": 4e3, "edge.rotational_stiffness": 70.0, "lump.mass": 0.1,
        }  # fmt: skip
        known = {name: scale * value for name, value in scaled.items()}
        known |= {
            "plate.poisson_ratio": 0.3, "plate.thickness": 0.003, "lump.x": 0.3, "lump.y": 0.6, "patch.x": 0.6,
            "loss.stiffness_loss_factor": 0.01, "patch.y": 0.4, "patch.size": 0.3, "patch.factor": 0.6,
        }  # fmt: skip
        model = PlateModel(Mesh(0.43, 0.3, 4, 4), effects, known, {}, [3, 17], [7, 9], "accelerance")
        found.append(scale * model.frf(torch.zeros(0, dtype=torch.float64), lines))
    torch.testing.assert_close(*found, rtol=1e-8, atol=0.0)
    beside = truth("two", density={"value": 8200.0}, ground_spring={"x": 0.2, "y": 0.7, "stiffness": 300.0})
    assert "sensor_gain" in twins("density", beside)
