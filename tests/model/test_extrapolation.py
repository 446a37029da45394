"""Two meshes tell what an infinitely fine one would say."""

import dataclasses
import json
import math

import pytest
import torch
from threadpoolctl import threadpool_limits

from torchplate.cli.config.build import load_model, load_run
from torchplate.effects import Absorber, DampingPatch, MeshDiscretisation, Plate, PointMass, SupportSpring
from torchplate.model import PlateModel, Searched, SparseModel, extrapolate, reduce
from torchplate.model.discretisation.reduced_basis import ritz_basis
from torchplate.plate import Assembly, Mesh

YOUNG, POISSON, DENSITY, THICKNESS = 7.1e10, 0.3, 2730.0, 0.0032
NOTHING = torch.zeros(0, dtype=torch.float64)
# ω a² √(ρh/D) of the free square plate at ν = 0.3: Leissa, J. Sound Vib. 31 (1973) 257; Hurlebaus, Int. J. Solids
# Struct. 44 (2007) 4883, whose digits are all right.
FREE_SQUARE = (13.4682, 19.5961, 24.2702, 34.8009, 34.8009)
HELD = dict.fromkeys(("x0", "x1", "y0", "y1"), "simply_supported")
# A mesh error is to fall by this much at least.
BETTER = 20


def bare(mesh: Mesh, searched=None, effects=None) -> PlateModel:
    known = {"youngs_modulus": YOUNG, "poisson_ratio": POISSON, "density": DENSITY, "thickness": THICKNESS}
    searched = searched or {}
    known = {f"plate.{key}": value for key, value in known.items() if f"plate.{key}" not in searched}
    return PlateModel(mesh, {"plate": Plate(), **(effects or {})}, known, searched)


def speed() -> float:
    """√(D/ρh) [m²/s]."""
    return math.sqrt(YOUNG * THICKNESS**2 / (12 * (1 - POISSON**2) * DENSITY))


def navier(mesh: Mesh, n_mode: int) -> torch.Tensor:
    """Natural frequencies of the simply supported plate [Hz], exactly."""
    n = torch.arange(1.0, 12.0, dtype=torch.float64)
    every = math.pi / 2 * speed() * ((n / mesh.length_x) ** 2 + (n[:, None] / mesh.length_y) ** 2)
    return every.flatten().sort().values[:n_mode]


def off(found: torch.Tensor, exact: torch.Tensor) -> torch.Tensor:
    return (found / exact - 1).abs()


def test_a_free_square_plate_vibrates_as_published():
    mesh = Mesh(0.37, 0.37, 12, 12)
    model = bare(mesh)
    better = extrapolate(model).model
    exact = torch.tensor(FREE_SQUARE, dtype=torch.float64) * speed() / (2 * math.pi * mesh.length_x**2)
    plain, found = (one.natural_frequencies(NOTHING, 8)[3:] for one in (model, better))
    # The mesh's error of the pair happens to pass through zero near here, so that the worst of each are compared.
    assert BETTER * float(off(found, exact).max()) < float(off(plain, exact).max())
    assert bool((BETTER * off(found, exact) < off(plain, exact))[:3].all())
    # And the pair is still one, to what ARPACK leaves.
    assert float(found[4] / found[3] - 1) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("sides", [(0.5, 0.3), (0.42, 0.42)], ids=["rectangle", "square"])
def test_a_simply_supported_plate_vibrates_as_navier_says(sides):
    mesh = Mesh(*sides, 12, 11, edges=HELD)
    model = bare(mesh)
    seen = extrapolate(model)
    exact = navier(mesh, 6)
    plain, found = (one.natural_frequencies(NOTHING, 6) for one in (model, seen.model))
    assert bool((BETTER * off(found, exact) < off(plain, exact)).all())
    # It knows by how much the mesh was off.
    assert torch.allclose(seen.frequency[:6], plain, rtol=1e-7, atol=0)
    assert torch.allclose(seen.error[:6].abs(), off(plain, exact), rtol=0.1, atol=0)


def test_modes_that_the_mesh_repeats_stay_repeated_up_to_the_last():
    # Modes beyond the cut stay as they are: a pair must not be parted by it, wherever it falls.
    for frequency in (None, 900.0, 1500.0, 2300.0):
        model = bare(Mesh(0.37, 0.37, 6, 6))
        plain = model.natural_frequencies(NOTHING, 90)
        found = extrapolate(model, frequency).model.natural_frequencies(NOTHING, 90)
        n_pair = int(((plain.diff() / plain[1:])[3:] < 1e-9).sum())
        assert n_pair > 15
        # A mode that is corrected may pass one that is not: so the pairs are counted.
        assert int(((found.diff() / found[1:])[3:] < 1e-6).sum()) == n_pair


BENT = {"wires.stiffness": 2100.0, "wires.viscous_damping": 3.0, "loss.stiffness_loss_factor": 8e-3, "lump.mass": 0.06}
BETWEEN = {"response": [(0.37, 0.61), (0.93, 0.18)], "reference": [(0.11, 0.84), (0.52, 0.43)]}


@pytest.mark.parametrize(
    "sides",
    [pytest.param((0.51, 0.33), id="rectangle"), pytest.param((0.42, 0.42), id="square", marks=pytest.mark.check)],
)
def test_frfs_between_the_nodes_come_near_those_of_a_much_finer_mesh(plates, relative_error, sides):
    mesh = Mesh(*sides, 10, 8)
    lines = torch.linspace(20.0, 3.2 * plates.first_bending(mesh), 13, dtype=torch.float64)
    # So much loss that no peak falls between the lines.
    known = BENT | {"loss.stiffness_loss_factor": 0.04}
    model = plates.build(mesh, known, **BETWEEN)
    better = extrapolate(model, float(lines[-1])).model
    much_finer = plates.build(dataclasses.replace(mesh, refine=5), known, **BETWEEN)
    expected = SparseModel(much_finer, NOTHING).frf(lines)
    plain, found = (relative_error(one.frf(NOTHING, lines), expected) for one in (model, better))
    assert plain > 0.008
    # A lump bends the plate in its neighbourhood alone, which no few modes tell.
    assert found < plain / 2.5
    direct = better.frf_direct(NOTHING, lines)
    assert relative_error(better.frf(NOTHING, lines), direct) < 1e-9


def test_the_finer_mesh_is_never_assembled_densely(monkeypatch):
    """Its dense matrices would take sixteen times the memory of those of the mesh itself."""
    assembled = set()
    scatter = Assembly._scatter

    def seen(assembly, *values):
        assembled.add(assembly.mesh.refine)
        return scatter(assembly, *values)

    monkeypatch.setattr(Assembly, "_scatter", seen)
    extrapolate(bare(Mesh(0.51, 0.33, 4, 3)))
    assert assembled == {1}


def test_sparse_matrices_say_what_dense_ones_do(relative_error):
    model = bare(Mesh(0.51, 0.33, 7, 6))
    model.response, model.reference = BETWEEN["response"], BETWEEN["reference"]
    better = extrapolate(model).model
    sparse = SparseModel(better, NOTHING)
    dense = better.natural_frequencies(NOTHING, 15)[3:]
    for found in (sparse.modes(14), sparse.modes(14, dense=True)):
        # Rounding of the whole spectrum, as for the plain mesh.
        assert torch.allclose(found.frequency[3:15], dense, rtol=1e-6, atol=0)
    lines = torch.tensor([31.0, 77.0, 160.0, 311.0], dtype=torch.float64)
    assert relative_error(sparse.frf(lines), better.frf_direct(NOTHING, lines)) < 1e-7
    # And both say something else than the mesh alone.
    assert relative_error(sparse.frf(lines), model.frf_direct(NOTHING, lines)) > 1e-3


@pytest.mark.parametrize("name", ["youngs_modulus", "thickness", "density"])
def test_other_plates_of_the_box_are_corrected_in_proportion(name):
    power = {"youngs_modulus": 0.5, "thickness": 1.0, "density": -0.5}[name]
    value = {"youngs_modulus": YOUNG, "thickness": THICKNESS, "density": DENSITY}[name]
    model = bare(Mesh(0.5, 0.31, 5, 4), {f"plate.{name}": Searched(0.6 * value, 1.4 * value)})
    better = extrapolate(model).model
    factor = torch.tensor([0.66, 0.9, 1.33], dtype=torch.float64)
    found = better.natural_frequencies(value * factor[:, None], 12)[:, 3:]
    middle = better.natural_frequencies(value * torch.ones(1, dtype=torch.float64), 12)[3:]
    assert torch.allclose(found, factor[:, None] ** power * middle, rtol=1e-8, atol=0)


class TestConfig:
    FILE = {
        "mesh": {"length_x": 0.5, "length_y": 0.31, "n_x": 5, "n_y": 4},
        "measurement": {"band": [10.0, 400.0], "response": [2, [0.41, 0.77]], "reference": [9]},
        "effects": {
            "plate": {
                "effect": "plate",
                "youngs_modulus": YOUNG,
                "poisson_ratio": POISSON,
                "density": DENSITY,
                "thickness": THICKNESS,
            },
            "loss": {"effect": "hysteretic_damping", "stiffness_loss_factor": 0.02},
        },
    }
    LINES = torch.linspace(30.0, 390.0, 19, dtype=torch.float64)

    def loaded(self, folder, mesh=None, finer=None):
        content = self.FILE | {"mesh": self.FILE["mesh"] | (mesh or {})}
        if finer is not None:
            content = content | {"effects": content["effects"] | {"finer": {"effect": "mesh_discretisation"} | finer}}
        path = folder / "plate.yaml"
        path.write_text(json.dumps(content))
        return path

    @pytest.mark.parametrize("refine", [1, 2])
    def test_the_mesh_and_the_effect_say_the_same(self, tmp_path, refine):
        given = load_run(self.loaded(tmp_path, {"refine": refine})).model()
        expected = extrapolate(given, 400.0).model.frf(NOTHING, self.LINES)
        by_mesh = load_model(self.loaded(tmp_path, {"refine": refine, "extrapolate": True}))
        by_effect = load_model(self.loaded(tmp_path, finer={"refine": refine, "extrapolate": True}))
        assert torch.equal(by_mesh.frf(NOTHING, self.LINES), expected)
        assert torch.equal(by_effect.frf(NOTHING, self.LINES), expected)
        assert not torch.allclose(given.frf(NOTHING, self.LINES), expected, rtol=1e-3)

    def test_it_is_right_where_the_mesh_is_not(self, tmp_path):
        run = load_run(self.loaded(tmp_path, {"extrapolate": True, "edges": HELD}))
        exact = navier(run.model().mesh, 4)
        plain, found = (one.natural_frequencies(NOTHING, 4) for one in (run.model_as_given(), run.model()))
        # Five by four elements: what is left is of the fourth order in a side of them.
        assert bool((5 * off(found, exact) < off(plain, exact)).all())


@pytest.mark.parametrize("cells", [(3, 2), (4, 3), (6, 5)])
@pytest.mark.parametrize("frequency", [None, 2500.0])
def test_modes_that_the_mesh_does_not_know_do_no_harm(cells, frequency):
    """A mesh of few elements has few modes that a finer one has too: the others are left alone."""
    model = bare(Mesh(0.5, 0.31, *cells, edges=HELD))
    seen = extrapolate(model, frequency)
    exact = navier(model.mesh, 4)
    plain, found = (one.natural_frequencies(NOTHING, 4) for one in (model, seen.model))
    assert bool((off(found, exact) < (1 + 1e-9) * off(plain, exact)).all())
    assert 4 * float(off(found, exact)[0]) < float(off(plain, exact)[0])
    assert 0 < len(seen.frequency) < model.assembly.size


def test_the_effect_alone_changes_no_mesh():
    mesh = bare(Mesh(0.5, 0.31, 5, 4), effects={"finer": MeshDiscretisation(1, True)}).mesh
    assert mesh == dataclasses.replace(Mesh(0.5, 0.31, 5, 4), extrapolate=True)


def test_a_projection_keeps_the_correction(plates, relative_error):
    mesh = Mesh(0.51, 0.33, 7, 6)
    model = plates.build(mesh, BENT, **BETWEEN)
    lines = torch.linspace(20.0, 250.0, 12, dtype=torch.float64)
    better = extrapolate(model, 250.0).model
    basis = ritz_basis(better, NOTHING[None], lines, 0, 3.0)
    projected = better.projected(basis)
    assert projected.assembly.size < better.assembly.size // 2
    assert set(projected.state_dict()) == set(model.state_dict())
    # What the basis leaves is far below what the correction changes.
    assert relative_error(projected.frf(NOTHING, lines), better.frf(NOTHING, lines)) < 1e-4
    assert relative_error(projected.frf(NOTHING, lines), model.frf(NOTHING, lines)) > 1e-2


@pytest.mark.parametrize("cells", [(6, 5), (20, 17)], ids=["dense", "sparse"])
@pytest.mark.check
def test_a_corrected_model_can_be_reduced(plates, relative_error, cells):
    young = Searched(0.8 * YOUNG, 1.2 * YOUNG)
    model = plates.build(Mesh(0.51, 0.33, *cells), BENT, {"plate.youngs_modulus": young}, **BETWEEN)
    lines = torch.linspace(20.0, 250.0, 7, dtype=torch.float64)
    better = extrapolate(model, 250.0).model
    found = reduce(better, lines)
    assert found is not None
    reduced, error = found
    assert error < 1e-4
    theta = torch.tensor([1.07 * YOUNG], dtype=torch.float64)
    expected = better.frf_direct(theta, lines)
    assert relative_error(reduced.frf(theta, lines), expected) < 3e-4
    assert relative_error(model.frf_direct(theta, lines), expected) > 1e-3


@pytest.mark.parametrize("cut", [(), ((0.25, 0.25, 0.5, 0.75),)])
def test_modes_of_the_finer_mesh_from_those_of_the_coarser_leave_a_hundredth_of_the_error(monkeypatch, cut):
    effects = {"wires": SupportSpring(nodes=(2, 10, 112)), "mass": PointMass(), "hung": Absorber()}
    known = {"wires.stiffness": 4e3, "wires.viscous_damping": 1.0, "mass.x": 0.81, "mass.y": 0.13, "mass.mass": 0.03}
    known |= {"hung.x": 0.1, "hung.y": 0.2, "hung.mass": 0.02, "hung.stiffness": 2e5, "hung.viscous_damping": 0.3}
    model = bare(Mesh(0.48, 0.4, 16, 12, cut=cut))
    model = model.replaced(effects=dict(model.effects) | effects, known=model.known_values | known)

    def error(limit: float) -> torch.Tensor:
        monkeypatch.setattr("torchplate.model.discretisation.extrapolation.TWO_GRIDS", limit)
        return extrapolate(model, 400.0).error

    solved, near = error(math.inf), error(0)
    in_band = model.natural_frequencies(NOTHING, len(near)) <= 400.0
    assert 8 < int(in_band.sum()) < len(near) <= len(solved)
    off = (near - solved[: len(near)]).abs()
    assert float(off.max()) < 1e-2 * float(solved[: len(near)].abs().max())
    # In the band they are far from what was left out: one step leaves 2e-5 of the mesh error there, two leave 1e-7.
    assert float(off[in_band].max()) < 1e-6 * float(solved[: len(near)][in_band].abs().max())


def test_of_a_plate_with_a_single_mode_on_both_meshes_that_one_is_corrected():
    """Four elements on simple supports: the second mode of the finer mesh is none of the coarser one's."""
    model = bare(Mesh(0.5, 0.31, 2, 2, edges=HELD))
    seen = extrapolate(model)
    assert seen.frequency.shape == (1,)
    exact = navier(model.mesh, 1)
    plain, found = (one.natural_frequencies(NOTHING, 1) for one in (model, seen.model))
    assert bool((4 * off(found, exact) < off(plain, exact)).all())


def test_where_nobody_says_at_which_plate_the_mesh_error_is_that_of_the_middle_of_the_box():
    model = bare(Mesh(0.48, 0.4, 4, 4), {"plate.poisson_ratio": Searched(0.2, 0.4)})
    middle, other = (torch.tensor([ratio], dtype=torch.float64) for ratio in (0.3, 0.38))
    found = extrapolate(model, 400.0).error
    assert float((found - extrapolate(model, 400.0, middle).error).abs().max()) < 1e-9
    assert float((found - extrapolate(model, 400.0, other).error).abs().max()) > 1e-5


def test_of_elements_that_all_lose_alike_the_mesh_takes_as_much_of_the_loss_as_of_the_stiffness():
    plain, patch = bare(Mesh(0.4, 0.4, 5, 5)), {"x": 0.5, "y": 0.5, "size": 1.0, "loss_factor": 0.2}
    known = plain.known_values | {f"patch.{name}": value for name, value in patch.items()}
    model = PlateModel(plain.mesh, {"plate": Plate(), "patch": DampingPatch()}, known)
    lacks = extrapolate(model, 400.0).model.assembly.correction
    assert float(lacks.stiffness.abs().max()) > 0
    torch.testing.assert_close(
        lacks.loss, 0.2 * lacks.stiffness, rtol=0, atol=1e-7 * float(lacks.stiffness.abs().max())
    )


def test_of_elements_that_lose_each_its_own_the_loss_of_modes_is_that_of_a_finer_mesh(plates):
    def loss_of_modes(model: PlateModel) -> torch.Tensor:
        system, modes = model.system(NOTHING), model.modes(NOTHING)
        return ((modes.shape * (system.hysteretic @ modes.shape)).sum(0) / modes.eigenvalue)[3:8]

    def lossy(n: int) -> PlateModel:
        return plates.build(Mesh(0.7, 0.4, 3 * n, 2 * n), {"field.base": 0.05}, loss_field=True)

    coarse, fine = lossy(2), loss_of_modes(lossy(8))
    corrected = extrapolate(coarse, float(coarse.natural_frequencies(NOTHING, 9)[8])).model
    before, after = (float(off(loss_of_modes(model), fine).max()) for model in (coarse, corrected))
    assert after < before / BETTER


@pytest.mark.parametrize("along", [0.25, 1.0], ids=["amid", "edge"])
def test_where_a_mass_and_a_spring_sit_the_deflections_that_modes_lack_count_once(along):
    """They are in the eigenvalues of both meshes already."""
    effects = {"point": PointMass(), "support": SupportSpring(at=((0.75, 0.5),))}
    own = {"point.x": along, "point.y": 0.25, "point.mass": 0.05, "support.stiffness": 2e5}
    known = bare(Mesh(0.6, 0.36, 8, 4)).known_values | own

    def squares(refine: int, corrected: bool) -> torch.Tensor:
        mesh = Mesh(0.6, 0.36, 8, 4, refine=refine)
        model = PlateModel(mesh, {"plate": Plate(), **effects}, known, {})
        model = extrapolate(model, 400.0).model if corrected else model
        return model.natural_frequencies(NOTHING)[2:12].square()

    coarse, fine = squares(1, False), squares(2, False)
    richardson = (4 * fine - coarse) / 3
    torch.testing.assert_close(squares(1, True), richardson, rtol=2e-3, atol=0.0)
    assert float((coarse / richardson - 1).abs().max()) > 5e-3


def test_on_two_threads_it_is_the_same_to_the_last_digit():
    model = bare(Mesh(0.48, 0.4, 16, 12))
    found = []
    for n in (1, 2):
        with threadpool_limits(limits=n, user_api="blas"):
            found.append(extrapolate(model, 400.0).error)
    assert torch.equal(*found)
