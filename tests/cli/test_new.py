"""`new` writes a config that runs as it is, with what it guessed marked as a guess."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchplate.cli.config.build import load_run
from torchplate.cli.main import main
from torchplate.measurement import Channel, Measurement, read_measurement, write_uff
from torchplate.studies.chairs import ROVED

# The roving-hammer test of the studies' second chair, without its magnet, and with a quarter of its lines.
SHORT = {"modal_test": ROVED["modal_test"] | {"analyser": ROVED["modal_test"]["analyser"] | {"n_line": 400}}}
TRUTH = ROVED | {"effects": {label: body for label, body in ROVED["effects"].items() if label != "magnet"}} | SHORT
SIDES = (TRUTH["mesh"]["length_x"], TRUTH["mesh"]["length_y"])
Place = tuple[float, float, float]


@pytest.fixture(scope="module")
def roved(tmp_path_factory) -> Measurement:
    """A virtual roving-hammer test at 3 × 5 points, read at the corner."""
    folder = tmp_path_factory.mktemp("roved")
    (folder / "truth.yaml").write_text(json.dumps(TRUTH))
    assert main(["simulate", str(folder / "truth.yaml"), "--out", str(folder / "test.uff")]) == 0
    return read_measurement(folder / "test.uff")


def written(measurement: Measurement, path: Path, where: Callable[[Place], Place] | None) -> Path:
    def moved(channel: Channel) -> Channel:
        place = channel.coordinate
        return replace(channel, coordinate=None if where is None or place is None else where(place))

    ends = {end: tuple(moved(c) for c in getattr(measurement, end)) for end in ("response", "reference")}
    write_uff(replace(measurement, **ends), path)
    return path


def turned(place: Place) -> Place:
    c, s = math.cos(math.radians(27)), math.sin(math.radians(27))
    x, y, _ = place
    return 1e3 * (0.1 + c * x - s * y), 1e3 * (s * x + c * y - 0.2), 5.0


FRAMES = {
    "millimetres": (lambda p: (1e3 * p[0], 1e3 * p[1], 0.0), ()),
    "from the middle": (lambda p: (p[0] - 0.21, p[1] - 0.15, 0.0), ()),
    "turned": (turned, ()),
    "sides exchanged": (lambda p: (0.3 - p[1], p[0], 0.0), ("--length", "0.42", "0.3")),
}
PLATE = ("--thickness", "0.003", "--material", "aluminium")


@pytest.mark.parametrize(("where", "more"), FRAMES.values(), ids=FRAMES)
@pytest.mark.check
def test_the_channels_come_to_their_places_whatever_the_file_counts_from(where, more, roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", where)
    config = tmp_path / "plate.yaml"
    status, out, error = command("new", file, *PLATE, *more, "--out", config)
    assert (status, error) == (0, "")
    assert "guess: " in out
    recipe = load_run(config)
    assert (recipe.config.mesh.length_x.value, recipe.config.mesh.length_y.value) == pytest.approx(SIDES, rel=1e-5)
    found = recipe.placement(recipe.measurement())
    expected = [(c.coordinate[0] / SIDES[0], c.coordinate[1] / SIDES[1]) for c in roved.reference]
    # Which corner of the plate is (0, 0) changes nothing on a rectangle: x and y may both count from the other end.
    places = torch.tensor(expected, dtype=torch.float64)
    assert any(
        torch.allclose((flip - found.reference_place).abs(), places, atol=1e-4)
        for flip in (torch.tensor([x, y], dtype=torch.float64) for x in (0.0, 1.0) for y in (0.0, 1.0))
    )


@pytest.mark.check
def test_the_config_runs_and_finds_the_modulus(roved, tmp_path, command, monkeypatch):
    # What is drawn is not asked for here, and takes most of the time.
    monkeypatch.setattr("torchplate.report.run.png", lambda *_: b"")
    monkeypatch.setattr("torchplate.report.forms.page._picture", lambda _: "")
    file = written(roved, tmp_path / "test.uff", turned)
    config = tmp_path / "plate.yaml"
    assert command("new", file, *PLATE, "--out", config)[0] == 0
    text = config.read_text()
    assert "gain: known" in text
    assert "# guess: turned by 27 degrees in the file's xy plane" in text
    assert "elements along the shortest bending wave at 400 Hz" in text
    model = load_run(config).model()
    assert model.names == ("plate.youngs_modulus", "loss.stiffness_loss_factor")
    objective = load_run(config).objective(model)
    modulus = torch.linspace(67e9, 75e9, 33, dtype=torch.float64)
    value = objective(torch.stack([modulus, torch.full_like(modulus, 0.008)], dim=1))
    # The mesh is up to 0.4 % off in frequency, so 1 % in E.
    assert float(modulus[value.argmin()]) == pytest.approx(70.5e9, rel=0.01)
    fewer = ("search.n_generation=2", "search.n_member=6", "log.n_figure=0", "mesh.n_x=4", "mesh.n_y=2")
    overrides = [word for text in fewer for word in ("--set", text)]
    assert command("run", config, "--out", tmp_path / "run", *overrides)[0] == 0
    assert (tmp_path / "run" / "result.json").is_file()


@pytest.mark.check
def test_the_air_and_a_thickness_that_wanders_are_a_comment_away(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    config = tmp_path / "plate.yaml"
    assert command("new", file, *PLATE, "--out", config)[0] == 0
    # A virtual test has no air unless its truth has.
    assert "air" not in load_run(config).config.effects
    text = config.read_text()
    for key in ("air", "thickness_scatter"):
        assert text.count(f"  # {key}: ") == 1
        text = text.replace(f"  # {key}: ", f"  {key}: ")
    config.write_text(text)
    recipe = load_run(config)
    assert recipe.model().known_values["air.density"] == 1.2
    assert recipe.imperfections().thickness_scatter == 0.005


def test_a_level_in_g_is_not_taken_for_si(roved, tmp_path, command):
    file = written(replace(roved, frf=roved.frf / 9.81), tmp_path / "test.uff", lambda p: p)
    assert command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")[0] == 0
    text = (tmp_path / "plate.yaml").read_text()
    assert "gain: unknown" in text
    assert "its unit is not believed" in text


@pytest.mark.check
def test_a_file_without_places_takes_a_table(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", None)
    status, _, error = command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert "--nodes nodes.csv" in error
    assert error.count("\n") == 1
    rows = [f"{c.node},{1e3 * c.coordinate[0]:.6f},{1e3 * c.coordinate[1]:.6f}" for c in roved.reference]
    (tmp_path / "nodes.csv").write_text("\n".join(["node,x,y", *rows]))
    config = tmp_path / "configs" / "plate.yaml"
    assert command("new", file, *PLATE, "--nodes", tmp_path / "nodes.csv", "--out", config)[0] == 0
    recipe = load_run(config)
    assert recipe.raw["measurement"]["nodes"] == "../nodes.csv"
    assert recipe.placement(recipe.measurement()).by == "coordinate"


@pytest.mark.check
def test_without_thickness_the_resonances_tell_it(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    status, out, _ = command("new", file, "--material", "aluminium", "--out", tmp_path / "plate.yaml")
    assert status == 0
    # A model of few elements and steps of 1 % tell 3 mm within the two digits that are said.
    assert "guess: thickness near 3 mm, by the resonances: give --thickness" in out
    recipe = load_run(tmp_path / "plate.yaml")
    ends = recipe.raw["effects"]["plate"]["thickness"]
    assert ends["low"] < 0.003 < ends["high"]
    assert recipe.raw["measurement"]["gain"] == "unknown"
    assert "plate.thickness" in recipe.model().names


@pytest.mark.check
def test_a_material_that_nobody_named_is_told_by_its_resonances(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    status, out, _ = command("new", file, "--thickness", "0.003", "--out", tmp_path / "plate.yaml")
    assert status == 0
    # √(70.5 GPa / 2700 kg/m³) is 5110 m/s.
    said = next(line for line in out.splitlines() if "√(E/ρ)" in line)
    assert said.startswith("  guess: √(E/ρ) is near 5")
    assert "aluminium" in said
    assert "material not named, so only h√(E/ρ) can be found: give --material" in said
    assert "grain" not in load_run(tmp_path / "plate.yaml").raw["effects"]
    # With its mass, what is as stiff for its weight and heavier is out.
    more = ("--mass", "1.02", "--force", "--out", tmp_path / "plate.yaml")
    out = command("new", file, "--thickness", "0.003", *more)[1]
    assert "as in aluminium: " in out or "as in aluminium; " in out


@pytest.mark.check
def test_guessed_sides_that_the_resonances_do_not_have_are_said_to_be_others(roved, tmp_path, command):
    """Points that keep a margin from the edges say nothing of it: the first run then explains nothing."""
    small = written(roved, tmp_path / "small.uff", lambda p: (0.85 * p[0], 0.85 * p[1], 0.0))
    status, out, _ = command("new", small, *PLATE, "--out", tmp_path / "plate.yaml")
    assert status == 0
    said = next(line for line in out.splitlines() if "the resonances lie at" in line)
    # Natural frequencies go with one over the sides squared; aluminium's √(E/ρ) is known to 3 % or so.
    assert float(re.search(r"lie at ([\d.]+) of those of such a plate of 0.357 × 0.255 m", said)[1]) == pytest.approx(
        0.85**2, rel=0.03
    )
    larger = re.search(r"some ([\d.]+) × ([\d.]+) m\. Measure the sides and give --length", said)
    assert float(larger[1]) * float(larger[2]) == pytest.approx(math.prod(SIDES), rel=0.03)
    # One margin on all sides.
    assert float(larger[1]) - 0.357 == pytest.approx(float(larger[2]) - 0.255, abs=1.5e-3)
    assert "# the resonances lie at" in (tmp_path / "plate.yaml").read_text()
    # Told, or right, nothing is said.
    more = ("--length", "0.357", "0.255", "--force", "--out", tmp_path / "plate.yaml")
    assert "resonances" not in command("new", small, *PLATE, *more)[1]
    right = written(roved, tmp_path / "test.uff", lambda p: p)
    assert "resonances" not in command("new", right, *PLATE, "--out", tmp_path / "right.yaml")[1]


@pytest.mark.parametrize(
    ("where", "axis", "words"),
    [
        (lambda p: (100 * p[0] - 21, 100 * p[1] - 15, 0.0), 1.0, "in cm it would have 0.42 × 0.3 m: give --unit cm"),
        (lambda p: p, 1e-3, "the frequency axis looks like kHz that are taken for Hz"),
        (lambda p: p, 2 * math.pi, "the frequency axis looks like rad/s that are taken for Hz"),
    ],
)
@pytest.mark.check
def test_a_unit_that_the_resonances_contradict_is_named(where, axis, words, roved, tmp_path, command):
    file = written(replace(roved, frequency=axis * roved.frequency), tmp_path / "test.uff", where)
    status, out, _ = command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")
    assert status == 0
    assert words in next(line for line in out.splitlines() if "the resonances lie at" in line)


def test_nodes_that_the_geometry_has_not_are_named(roved, tmp_path, command):
    """A mesh that nobody has asked for was blamed: "node numbers from 1 to 25 on the 4 × 4 mesh"."""
    odd = replace(roved.reference[-1], node=977)
    file = written(replace(roved, reference=(*roved.reference[:-1], odd)), tmp_path / "test.uff", lambda p: p)
    text = file.read_bytes().decode("latin-1").splitlines(keepends=True)
    (place,) = (k for k, line in enumerate(text) if line.split()[:1] == ["977"])
    held = text[:place] + text[place + (2 if len(text[place].split()) == 4 else 1) :]
    file.write_bytes("".join(held).encode("latin-1"))
    status, _, error = command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert error.count("\n") == 1
    for word in ("got none of 977", "labels 1 to", "--nodes nodes.csv"):
        assert word in error
    assert "mesh" not in error


@pytest.mark.check
def test_wood_that_nobody_named_is_told_by_its_resonances(tmp_path, command):
    grain = {"effect": "orthotropy", "young_ratio": 11.0, "shear_factor": 0.9}
    plate = {"effect": "plate", "youngs_modulus": 3.3e9, "poisson_ratio": 0.1, "density": 440.0, "thickness": 0.004}
    analyser = TRUTH["modal_test"]["analyser"] | {"n_line": 400}
    truth = TRUTH | {"effects": TRUTH["effects"] | {"plate": plate, "grain": grain}}
    truth["modal_test"] = TRUTH["modal_test"] | {"analyser": analyser, "refine": 4}
    (tmp_path / "truth.yaml").write_text(json.dumps(truth))
    assert command("simulate", tmp_path / "truth.yaml", "--out", tmp_path / "test.uff")[0] == 0
    status, out, _ = command("new", tmp_path / "test.uff", "--out", tmp_path / "plate.yaml")
    assert status == 0
    # The shorter side is along the grain, which the longer one is taken to be where nothing else is known.
    assert "the resonances are those of wood with its grain along y" in out
    assert "material taken as wood: give --material spruce" in out
    raw = load_run(tmp_path / "plate.yaml").raw
    ratio, shear = raw["effects"]["grain"]["young_ratio"], raw["effects"]["grain"]["shear_factor"]
    assert ratio["low"] < 11.0 < ratio["high"]
    assert shear["low"] < 0.9 < shear["high"]
    # 4 mm of √(3.3 GPa / 440) m/s are as stiff as 4.47 mm of wood's usual √(3 GPa / 500).
    assert raw["effects"]["plate"]["thickness"]["low"] < 0.00447 < raw["effects"]["plate"]["thickness"]["high"]
    assert raw["measurement"]["gain"] == "unknown"


@pytest.mark.check
def test_wood_is_searched_along_and_across_the_grain(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    options = ("--thickness", "0.003", "--material", "spruce", "--mass", "0.17")
    assert command("new", file, *options, "--out", tmp_path / "plate.yaml")[0] == 0
    recipe = load_run(tmp_path / "plate.yaml")
    assert {"grain.young_ratio", "grain.shear_factor"} < set(recipe.model().names)
    # 0.17 kg / (0.42 · 0.3 · 0.003 m³)
    assert recipe.raw["effects"]["plate"]["density"] == pytest.approx(449.7, abs=0.1)


@pytest.mark.check
def test_supports_and_edges_come_into_the_model(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    more = ("--supports", "0.021,0", "0.42,0.15", "--edge", "y1=simply_supported")
    assert command("new", file, *PLATE, *more, "--out", tmp_path / "plate.yaml")[0] == 0
    recipe = load_run(tmp_path / "plate.yaml")
    assert recipe.raw["effects"]["supports"]["at"] == [[0.05, 0], [1, 0.5]]
    assert recipe.config.mesh.edges == {"y1": "simply_supported"}
    recipe.model()


@pytest.mark.check
def test_an_edge_that_nobody_said_how_it_is_held_is_a_guess(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    status, printed, _ = command("new", file, *PLATE, "--edge", "x0", "--edge", "y1=free", "--out", tmp_path / "a.yaml")
    assert status == 0
    assert "guess: edge x0 taken as clamped" in printed
    assert "y1" not in printed
    assert load_run(tmp_path / "a.yaml").config.mesh.edges["x0"] == "clamped"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--thickness", "3"), "--thickness 0.003"),
        (("--length", "420", "300"), "--length 0.42 0.3"),
        (("--length", "42", "30"), "look like cm. Write --length 0.42 0.3."),
        (("--length", "120", "90"), "cm or mm. Write --length 1.2 0.9 or --length 0.12 0.09."),
        (("--length", "0.2", "0.3"), "Correct --length"),
        (("--length", "-0.4", "0.3"), "above 0 in m"),
        (("--material", "unobtainium"), "steel, stainless_steel"),
        (("--supports", "corner"), "--supports 0.05,0"),
        (("--supports", "free", "springs"), "Expected free alone, got free springs"),
        (("--supports", "0.5,0"), "on the plate"),
        (("--edge", "left=clamped"), "x0, x1, y0, y1"),
        (("--edge", "x0=glued"), "clamped"),
        (("--mass", "0"), "above 0 in kg"),
        (("--nodes", "absent.csv"), "absent.csv"),
        (("--out", "plate.txt"), ".yaml"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(options, words, roved, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(roved, tmp_path / "test.uff", lambda p: p)
    base = PLATE if "--thickness" not in options else ()
    more = ("--length", *map(str, SIDES), "--thickness", "0.003") if "--thickness" not in options else (
        "--length", *map(str, SIDES)
    )  # fmt: skip
    more = more if "--length" not in options else ()
    status, _, error = command("new", "test.uff", *base, *more, *options)
    assert status == 2
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "test.yaml").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        # Sides that come from the points are no excuse.
        (("--thickness", "3", "--material", "aluminium"), ["--thickness", "0.42 × 0.3 m", "--thickness 0.003"]),
        (("--thickness", "0.003", "--mass", "1020"), ["--mass", "kg/m³", "--mass 1.02"]),
        # 1020 kg / (0.42 · 0.3 · 0.2 · 0.3 m³)
        (("--mass", "1020"), ["--mass", "a density of at least 1.35e+05 kg/m³. For g write --mass 1.02."]),
        ((*PLATE, "--unit", "mm"), ["--unit", "0.00042 × 0.0003 m", "Leave it out"]),
    ],
)
def test_what_cannot_be_beside_the_points_is_refused_by_the_option_s_name(options, words, roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    status, _, error = command("new", file, *options, "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert error.count("\n") == 1
    assert all(word in error for word in words), error
    # A second try finds its place empty.
    assert not (tmp_path / "plate.yaml").exists()


@pytest.mark.check
def test_the_unit_that_a_table_s_head_states_is_taken_by_new_and_by_the_config(roved, tmp_path, command):
    """42 × 30 of something is taken for mm where nothing says so, a plate of a tenth of its sides."""
    file = written(roved, tmp_path / "test.uff", None)
    channels = {c.node: c.coordinate for c in (*roved.response, *roved.reference)}
    rows = "\n".join(f"{node},{100 * x:g},{100 * y:g}" for node, (x, y, _) in sorted(channels.items()))
    (tmp_path / "nodes.csv").write_text(f"node,x [cm],y [cm]\n{rows}\n")
    more = ("--nodes", tmp_path / "nodes.csv", "--out", tmp_path / "plate.yaml")
    status, text, _ = command("new", file, *PLATE, *more)
    assert status == 0
    assert "plate of 0.42 × 0.3 m" in text
    assert f"  places are taken in cm, as the head of {tmp_path / 'nodes.csv'} says." in text
    recipe = load_run(tmp_path / "plate.yaml")
    found = recipe.measurement()
    assert [c.coordinate for c in found.reference] == [pytest.approx(c.coordinate, abs=1e-6) for c in roved.reference]
    assert any("as the head of" in remark for remark in found.notes)
    # A config that a user has written: in m, without a frame; in inches, as of a drawing.
    for frame in ({}, {"frame": {"unit": "in"}}):
        raw = dict(recipe.raw) | {"measurement": {"file": "test.uff", "nodes": "nodes.csv"} | frame}
        (tmp_path / "own.yaml").write_text(json.dumps(raw))
        own = load_run(tmp_path / "own.yaml").measurement()
        assert [c.coordinate for c in own.reference] == [pytest.approx(c.coordinate, abs=1e-6) for c in roved.reference]
    status, _, error = command("new", file, *PLATE, *more, "--unit", "mm", "--overwrite")
    assert (status, error.count("\n")) == (2, 1)
    assert "--unit: Expected cm, as the head of" in error


@pytest.mark.check
def test_what_is_proposed_next_can_be_copied_where_a_name_has_blanks(roved, tmp_path, command, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(roved, tmp_path / "my test (2).uff", lambda p: p)
    status, text, _ = command("new", "my test (2).uff", *PLATE)
    assert status == 0
    assert text.splitlines()[-1] == "Next: torchplate run 'my test (2).yaml'; torchplate diagnose 'my test (2).yaml'"
    assert "`torchplate new 'my test (2).uff'`" in Path("my test (2).yaml").read_text()
    rows = [f"{f},{f},0" for f in range(10, 60)]
    Path("my frfs.csv").write_text("\n".join(["frequency,real,imag", *rows]))
    status, text, _ = command("frf", "my frfs.csv", "--response", 3, "--reference", 4, "--out", "my frfs.uff")
    assert status == 0
    assert text.splitlines()[-1] == "Next: torchplate new 'my frfs.uff' --nodes nodes.csv"


def test_a_config_that_exists_is_not_overwritten(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: p)
    (tmp_path / "plate.yaml").write_text("mine")
    status, _, error = command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert "one that exists" in error
    assert "--force" in error
    assert (tmp_path / "plate.yaml").read_text() == "mine"
    assert command("new", file, *PLATE, "--out", tmp_path / "plate.yaml", "--force")[0] == 0
    assert "torchplate new" in (tmp_path / "plate.yaml").read_text()


def test_a_broken_or_absent_file_is_refused(tmp_path, command):
    (tmp_path / "odd.uff").write_bytes(b"nothing")
    for name in ("odd.uff", "absent.uff", "test.xyz"):
        status, _, error = command("new", tmp_path / name, *PLATE, "--out", tmp_path / "plate.yaml")
        assert status == 2
        assert name in error


def test_the_help_has_an_example(capsys):
    for verb in ("new", "frf", "inspect"):
        with pytest.raises(SystemExit):
            main([verb, "--help"])
        assert f"torchplate {verb} " in capsys.readouterr().out.split("example")[1]


@pytest.mark.check
def test_the_measured_spruce_plate_gets_its_published_sides(command, tmp_path):
    file = Path(__file__).parents[2].parent / "shared" / "data" / "spruce_5L.uff"
    if not file.is_file():
        pytest.skip(f"{file} is absent: the measured files are not part of the project")
    config = tmp_path / "spruce.yaml"
    options = ("--thickness", "0.00503", "--mass", "0.2728", "--material", "spruce")
    assert command("new", file, *options, "--out", config)[0] == 0
    recipe = load_run(config)
    assert recipe.config.mesh.length_x.value == pytest.approx(0.5814, abs=1e-6)
    assert recipe.config.mesh.length_y.value == pytest.approx(0.2176, abs=1e-6)
    # Its level is 1.5 times that of such a plate, and the accelerometer was read upside down.
    assert recipe.config.measurement.gain == "unknown"
    low, high = recipe.config.measurement.band
    assert 20 < low < 60 < 250 < high < 600


@pytest.mark.check
def test_modes_of_a_file_in_millimetres_come_with_their_frame(roved, tmp_path, command):
    pytest.importorskip("sdypy.EMA")
    file = written(roved, tmp_path / "mm.uff", lambda p: (1e3 * p[0] - 210, 1e3 * p[1] - 150, 0.0))
    status, out, _ = command("modes", file, "--out", tmp_path / "modes.uff")
    assert status == 0
    assert "{modal_model: {file: modes.uff}, frame: {unit: mm, origin: [-210, -150, 0]}}" in out
    status, out, _ = command("modes", written(roved, tmp_path / "m.uff", lambda p: p), "--out", tmp_path / "m.csv")
    assert "{modal_model: {file: m.csv}}" in out
    # A file of modes alone has no FRFs, and goes into a config as it is.
    status, _, error = command("new", tmp_path / "modes.uff", "--out", tmp_path / "plate.yaml")
    assert status == 2
    assert "measurement: {modal_model: {file: modes.uff}}" in error


@pytest.mark.check
def test_a_unit_that_is_guessed_says_how_another_is_told(roved, tmp_path, command):
    file = written(roved, tmp_path / "test.uff", lambda p: (1e3 * p[0], 1e3 * p[1], 0.0))
    _, out, _ = command("new", file, *PLATE, "--out", tmp_path / "plate.yaml")
    assert "guess: coordinates taken in mm" in out
    assert "--unit cm or --unit in" in out
