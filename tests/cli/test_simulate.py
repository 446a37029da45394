"""A virtual test of a config, and the catalogue on the screen."""

import runpy

import pytest
import torch

from torchplate.cli.config.build import load_model
from torchplate.effects import CATALOGUE, options
from torchplate.measurement import read_measurement

QUICK = {"like": "sr785", "n_line": 50, "n_average": 1, "exponential_window": None}


def simulated(bench, make_config, command, suffix=".uff", changes=None, name="out"):
    settings = {"measurement": {}, "modal_test.analyser": QUICK, "modal_test.reference": [1, 6], "modal_test.refine": 1}
    path = bench.write(make_config(changes=settings | (changes or {})), "virtual.yaml")
    out = bench.folder / "new" / f"{name}{suffix}"
    status, stdout, _ = command("simulate", path, "--out", out)
    assert status == 0
    assert str(out) in stdout
    return read_measurement(out)


@pytest.mark.parametrize("suffix", [".uff", ".unv", ".npz"])
def test_the_virtual_test_is_written_in_the_format_of_its_name(bench, make_config, command, suffix):
    frfs = simulated(bench, make_config, command, suffix)
    # Without a response of its own it is read at node 3, as in the paper.
    assert [channel.node for channel in frfs.response] == [3]
    assert [channel.node for channel in frfs.reference] == [1, 6]
    assert frfs.reference[1].coordinate == pytest.approx((0.41 / 3, 0.29 / 2, 0.0), abs=1e-6)
    assert frfs.kind == "accelerance"
    assert len(frfs.frequency) == 51


def test_left_out_references_are_all_labelled_nodes(bench, make_config, command):
    frfs = simulated(bench, make_config, command, changes={"modal_test.reference": None})
    assert [channel.node for channel in frfs.reference] == list(range(1, 13))


def test_the_same_seed_gives_the_same_test_and_another_seed_another(bench, make_config, command):
    one, two, other = (
        simulated(bench, make_config, command, ".npz", {"modal_test.seed": seed}, name).frf
        for seed, name in ((7, "one"), (7, "two"), (8, "other"))
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, other)


def test_the_tested_plate_lies_on_a_finer_mesh(bench, make_config, command):
    coarse, fine = (
        simulated(bench, make_config, command, ".npz", {"modal_test.refine": refine}, f"out{refine}").frf[10:]
        for refine in (1, 3)
    )
    assert float((coarse - fine).norm() / fine.norm()) > 0.05


def test_a_model_can_be_loaded_without_its_measurement(bench, make_config):
    path = bench.write(make_config(["plate.youngs_modulus"], {"measurement.file": "later.uff"}))
    assert load_model(path).names == ("plate.youngs_modulus",)


def test_the_public_names_serve_a_script(bench, make_config):
    tp = pytest.importorskip("torchplate")
    model = tp.load_model(bench.write(make_config(["plate.youngs_modulus", "wires.stiffness"])))
    assert isinstance(model, tp.PlateModel)
    assert isinstance(model, torch.nn.Module)
    assert model.names == ("plate.youngs_modulus", "wires.stiffness")
    theta = torch.tensor([[2.0e11, 1000.0], [2.1e11, 1300.0], [1.7e11, 900.0]], dtype=torch.float64)
    frequency = torch.tensor([5.0, 90.0], dtype=torch.float64)
    assert model.frf(theta, frequency, response=[3], reference=[8, 10]).shape == (3, 2, 1, 2)
    # Left out, responses and references are those of the measurement.
    assert model.frf(theta[0], frequency).shape == (2, 2, 3)
    for optimizer in (tp.DifferentialEvolution(n_member=8), tp.ArtificialBeeColony(n_member=8)):
        outcome = tp.minimize(
            lambda u: (u - 0.3).square().sum(-1),
            optimizer,
            n_dimension=2,
            generator=torch.Generator().manual_seed(0),
            n_generation=60,
        )
        # Both narrow a parabola by orders of magnitude in 60 generations.
        assert outcome.best_position.tolist() == pytest.approx([0.3, 0.3], abs=0.02)


def test_the_catalogue_is_printed_whole(command):
    status, out, _ = command("effects")
    assert status == 0
    words = out.split()
    for name, effect in CATALOGUE.items():
        assert name in words
        for word in (*effect.parameters, *options(effect)):
            assert word in words


def test_the_module_is_the_command(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["torchplate", "effects"])
    with pytest.raises(SystemExit) as stop:
        runpy.run_module("torchplate", run_name="__main__")
    assert stop.value.code == 0
    assert set(CATALOGUE) <= set(capsys.readouterr().out.split())


IMPERFECT = {"position_std": 0.003, "frequency_drift": 0.001, "calibration_std": 0.02, "damping_scatter": 0.2}


@pytest.mark.check
def test_what_the_config_says_of_the_tests_imperfections_is_drawn(bench, make_config, command):
    def read(name, **measurement):
        settings = {"measurement": measurement} | {"modal_test.seed": 5}
        return simulated(bench, make_config, command, ".npz", settings, name)

    plain, none = read("plain"), read("none", **dict.fromkeys(IMPERFECT, 0.0))
    whole, again = read("whole", **IMPERFECT), read("again", **IMPERFECT)
    assert torch.equal(plain.frf, none.frf)
    assert torch.equal(whole.frf, again.frf)
    assert float((whole.frf - plain.frf)[10:].norm() / plain.frf[10:].norm()) > 0.02
    # The sheet says where the marks are.
    assert whole.reference == plain.reference
