"""A mesh that does not fit the machine is refused before any of it is made."""

import re

import pytest

from torchplate.cli.config import memory
from torchplate.plate import Mesh

GIGABYTE = 1e9


@pytest.fixture
def small_machine(monkeypatch):
    """A machine with 6 GB to spare, on which no mesh is ever made."""
    monkeypatch.setattr(memory, "available", lambda: 6 * GIGABYTE)
    for name in ("node_place", "element_dof", "free_dof"):
        assert hasattr(Mesh, name)
        monkeypatch.setattr(Mesh, name, property(lambda _: pytest.fail("a mesh was made")))


@pytest.mark.parametrize("verb", ["run", "diagnose", "simulate"])
@pytest.mark.parametrize(("n", "needed"), [(400, 8), (2000, 200)])
def test_a_mesh_that_does_not_fit_is_told_its_memory_and_the_finest_that_fits(
    bench, make_config, command, small_machine, verb, n, needed
):
    changes = {"mesh.n_x": n // 2, "mesh.n_y": n // 2, "mesh.refine": 2, "effects.wires.nodes": [2, 5, 11]}
    changes |= {"modal_test": {"refine": 1}}
    path = bench.write(make_config(["plate.youngs_modulus"] if verb != "simulate" else [], changes))
    out = bench.folder / ("test.uff" if verb == "simulate" else "out")
    status, _, stderr = command(verb, path, "--out", out)
    assert status == 2
    assert stderr.count("\n") == 1
    assert ",." not in stderr
    assert f"mesh: Expected a mesh that fits the 6 GB of memory that are free, got {n} × {n} elements" in stderr
    told = float(re.search(r"about ([\d.e+]+) GB", stderr)[1])
    assert told > needed
    best = [int(one) for one in re.search(r"finest that fits has about (\d+) × (\d+)", stderr).groups()]
    assert 50 < best[0] == best[1] < n
    assert not out.exists()


def test_the_finest_mesh_fits_and_keeps_the_proportion():
    for cells in ((300, 700), (4000, 500)):
        best = memory.finest(cells, 2 * GIGABYTE)
        assert memory.needed(best) <= 2 * GIGABYTE < memory.needed((int(1.1 * best[0]), int(1.1 * best[1])))
        # Whole elements: one in the shorter direction is a part of it.
        assert best[0] / best[1] == pytest.approx(cells[0] / cells[1], rel=1.5 / min(best))


def test_a_mesh_that_fits_is_run(bench, monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 6 * GIGABYTE)
    assert bench.run().result["objective"] is not None


@pytest.mark.parametrize(
    "changes", [{"n_member": 10**30}, {"n_repeat": 10**30}, {"n_member": 10**5, "n_repeat": 10**5}]
)
@pytest.mark.parametrize("optimizer", ["differential_evolution", "least_squares"])
def test_a_population_that_does_not_fit_is_told_its_memory(
    bench, make_config, command, changes, optimizer, monkeypatch
):
    monkeypatch.setattr("torchplate.identification.job.minimize", None)
    monkeypatch.setattr("torchplate.cli.config.searches.available", lambda: 6 * GIGABYTE)
    search = {"optimizer": optimizer} | changes
    path = bench.write(make_config(["plate.youngs_modulus"], {"search": search}))
    status, _, stderr = command("run", path, "--out", bench.folder / "out")
    assert (status, stderr.count("\n")) == (2, 1)
    assert re.search(r"search\.n_member: Expected a population that fits the 6 GB .* about [\d.e+]+ GB", stderr)


def test_this_machine_has_memory_to_spare_or_does_not_tell():
    found = memory.available()
    assert found is None or found > 0


def test_dofs_that_no_small_basis_serves_are_held_against_the_memory(bench, make_config, command, monkeypatch):
    monkeypatch.setattr("torchplate.identification.basis_check.reduce", lambda *_, **__: None)
    monkeypatch.setattr("torchplate.identification.job.minimize", None)
    monkeypatch.setattr(memory, "LEAST", 0.0)
    changes = {"mesh.refine": 12, "search.basis": "auto"}
    # 37 × 25 nodes: 50 MB sparse, 500 MB in dense matrices.
    monkeypatch.setattr(memory, "available", lambda: 0.2 * GIGABYTE)
    outcome = command("run", bench.write(make_config(["plate.youngs_modulus"], changes)), "--out", bench.folder / "out")
    assert outcome[0] == 2
    assert "2775 dofs for which no small basis is good enough" in outcome[2]
