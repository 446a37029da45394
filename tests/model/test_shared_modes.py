"""Plates that are multiples of one another: their FRFs without an eigenproblem are those of a direct solve."""

import pytest
import torch
from torch.func import hessian, jacfwd, jacrev, vmap

from torchplate.model import PlateModel, Searched, reduce, ritz_basis, sharing_modes
from torchplate.model.discretisation import fine_mesh
from torchplate.model.receptance import shared_modes
from torchplate.plate import Mesh
from torchplate.plate.transforms import REMEMBERED

# torch.func.jacfwd loads its own rules by torch.jit.script, which warns of itself.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")

MESHES = {
    "square": Mesh(0.48, 0.48, 5, 5),
    "rectangle": Mesh(0.7, 0.4, 6, 4),
    "cantilever": Mesh(0.7, 0.4, 5, 4, edges={"x0": "clamped"}),
}
SHAPES = pytest.mark.parametrize("mesh", MESHES.values(), ids=list(MESHES))
BOX = {
    "plate.youngs_modulus": Searched(5.3e10, 8.7e10),
    "plate.density": Searched(2500.0, 2900.0),
    "plate.thickness": Searched(0.0026, 0.0034),
    "wires.stiffness": Searched(1e2, 2e4, logarithmic=True),
    "wires.viscous_damping": Searched(0.1, 20.0),
    "loss.stiffness_loss_factor": Searched(1e-4, 3e-2),
    "loss.mass_loss_factor": Searched(10.0, 3e3),
    "rayleigh.mass_coefficient": Searched(0.5, 5.0),
    "rayleigh.stiffness_coefficient": Searched(1e-7, 2e-5),
    "lump.mass": Searched(0.0, 0.2),
}
# Eleven terms leave 3^-11 = 6e-6 of what the nearest far mode adds; more with Im z at an eighth of the width, and where
# a few lines miss all peaks.
SERIES = 5e-5


def made(plates, mesh: Mesh, searched=None, **options) -> tuple[PlateModel, PlateModel, torch.Tensor]:
    """The model, the same by shared modes, and lines up to six times the first bending mode."""
    options = {"response": [3, (0.61, 0.37)], "reference": [8, 12, (0.83, 0.71)], "kind": "accelerance"} | options
    model = plates.build(mesh, {}, BOX if searched is None else searched, **options)
    frequency = torch.linspace(0.0, 6.3, 41, dtype=torch.float64) * plates.first_bending(mesh)
    found = reduce(model, frequency)
    assert found is not None
    return model, found[0], frequency


def members(model: PlateModel, n: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return model.space.to_si(torch.rand(n, len(model.names), generator=generator, dtype=torch.float64))


def error(found: torch.Tensor, expected: torch.Tensor) -> float:
    return float(((found - expected).norm(dim=-3) / expected.norm(dim=-3)).max())


@SHAPES
@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_every_multiple_of_the_plate_has_the_frfs_of_a_direct_solve(plates, mesh: Mesh, kind: str) -> None:
    model, shared, frequency = made(plates, mesh, kind=kind)
    assert shared.shared_modes is not None
    theta = members(model, 7)
    # A free plate on weak wires at 0 Hz has no more digits: the line is left to the test below.
    assert error(shared.frf(theta, frequency[1:]), model.frf_direct(theta, frequency[1:])) < SERIES


def test_a_clamped_plate_shaken_by_its_edge_shares_its_modes(plates) -> None:
    searched = {key: BOX[key] for key in BOX if "wires" not in key}
    model, shared, frequency = made(plates, MESHES["cantilever"], searched, reference=None, kind="transmissibility")
    assert shared.shared_modes is not None
    theta = members(model, 7)
    assert error(shared.frf(theta, frequency), model.frf_direct(theta, frequency)) < SERIES


def test_a_plate_that_hangs_on_its_wires_has_its_static_flexibility_at_zero(plates) -> None:
    model, shared, _ = made(plates, MESHES["rectangle"], kind="receptance")
    theta, still = members(model, 5), torch.zeros(1, dtype=torch.float64)
    # The eigenvalues of the wires' modes are small beside the highest, which costs digits: 1e-16 · 1e9.
    assert error(shared.frf(theta, still), model.frf_direct(theta, still)) < 1e-5


@pytest.mark.parametrize("n_line", [1, 2, 3, 300])
@pytest.mark.check
def test_any_number_of_lines_and_members_is_as_good(plates, n_line: int) -> None:
    model, shared, frequency = made(plates, MESHES["square"])
    lines = torch.linspace(float(frequency[2]), float(frequency[-1]), n_line, dtype=torch.float64)
    for n_member in (1, 4):
        theta = members(model, n_member, seed=n_line)
        assert error(shared.frf(theta, lines), model.frf_direct(theta, lines)) < SERIES


def test_lines_go_in_blocks_that_fit_the_cache(plates, monkeypatch) -> None:
    model, shared, frequency = made(plates, MESHES["rectangle"])
    theta = members(model, 3)
    whole = shared.frf(theta, frequency)
    monkeypatch.setattr(shared_modes, "LINES_AT_ONCE", 4)
    # Each block has other modes near to it, so that only the series' error is common to both.
    assert error(shared.frf(theta, frequency), whole) < SERIES


def test_members_and_lines_beyond_the_box_and_the_band_are_as_good(plates) -> None:
    model, shared, frequency = made(plates, MESHES["rectangle"])
    theta = members(model, 3) * torch.tensor([0.4, 1.7, 1, 1, 1, 1, 1, 1, 1, 1], dtype=torch.float64)
    beyond = torch.linspace(2.0, 3.0, 9, dtype=torch.float64) * frequency[-1]
    assert error(shared.frf(theta, beyond), model.frf_direct(theta, beyond)) < SERIES


@pytest.mark.parametrize("loss", [0.3, 1.0])
def test_heavy_damping_is_within_the_series(plates, loss: float) -> None:
    searched = {"loss.stiffness_loss_factor": Searched(0.5 * loss, loss)}
    model, shared, frequency = made(plates, MESHES["square"], searched)
    theta = members(model, 4)
    assert error(shared.frf(theta, frequency[1:]), model.frf_direct(theta, frequency[1:])) < SERIES


def lump_anywhere() -> tuple[PlateModel, PlateModel, torch.Tensor]:
    """A plate that shares its modes, with a lump whose place is searched."""
    from torchplate.effects import Plate, PointMass

    known = {"plate.poisson_ratio": 0.3, "plate.density": 2700.0, "plate.thickness": 0.003}
    searched = {"plate.youngs_modulus": BOX["plate.youngs_modulus"], "lump.x": Searched(0.1, 0.9)}
    searched |= {"lump.y": Searched(0.2, 0.7), "lump.mass": Searched(0.0, 0.2)}
    model = PlateModel(
        Mesh(0.7, 0.4, 6, 4), {"plate": Plate(), "lump": PointMass()}, known, searched, [3], [8, 30], "accelerance"
    )
    frequency = torch.linspace(10.0, 400.0, 30, dtype=torch.float64)
    shared, _ = reduce(model, frequency)
    assert shared.shared_modes is not None
    return model, shared, frequency


def test_a_lump_whose_place_is_searched_is_attached_where_it_is() -> None:
    model, shared, frequency = lump_anywhere()
    theta = members(model, 6)
    assert error(shared.frf(theta, frequency), model.frf_direct(theta, frequency)) < SERIES


@pytest.mark.parametrize(
    "searched",
    [{"plate.poisson_ratio": Searched(0.2, 0.4)}, {"field.base": Searched(1e-3, 1e-2)}],
    ids=["poisson", "loss of single elements"],
)
def test_plates_that_are_no_multiples_share_no_modes(plates, searched) -> None:
    mesh = MESHES["rectangle"]
    model = plates.build(
        mesh, {}, searched, response=[3], reference=[8], loss_field=any("field" in name for name in searched)
    )
    theta = members(model, 4)
    assert shared_modes.find_shared_modes(model.assembly, model.plan(theta[0]), model.plan(theta)) is None


def test_a_fine_mesh_shares_modes_in_a_small_basis(plates, monkeypatch) -> None:
    monkeypatch.setattr(fine_mesh, "DENSE", 50)
    searched = {key: BOX[key] for key in list(BOX)[:5]}
    model, shared, frequency = made(plates, Mesh(0.7, 0.4, 9, 7), searched)
    assert shared.shared_modes is not None
    assert shared.assembly.size < model.assembly.size / 2
    theta = members(model, 5)
    # Ten times the tolerance of the basis: it is checked at other members.
    assert error(shared.frf(theta, frequency[1:]), model.frf_direct(theta, frequency[1:])) < 1e-3


@SHAPES
@pytest.mark.check
def test_derivatives_are_those_of_a_direct_solve(plates, mesh: Mesh) -> None:
    model, shared, frequency = made(plates, mesh)
    position = torch.rand(len(model.names), generator=torch.Generator().manual_seed(4), dtype=torch.float64)

    def on_cube(frf):
        def real(p: torch.Tensor) -> torch.Tensor:
            value = frf(model.space.to_si(p), frequency[1::5])
            return torch.view_as_real(value / expected_size).flatten()

        return real

    expected_size = model.frf(model.space.to_si(position), frequency[1::5]).abs().max()
    expected = jacrev(on_cube(model.frf_direct))(position)
    scale = expected.abs().amax(0)
    # A derivative of the series in z costs it a factor of about the number of its terms.
    for jacobian in (jacrev, jacfwd):
        found = jacobian(on_cube(shared.frf))(position)
        assert bool(((found - expected).abs() < 1e-5 * scale).all())
    many = position + 0.01 * torch.arange(3, dtype=torch.float64)[:, None]
    batched, single = vmap(jacfwd(on_cube(shared.frf)))(many), [jacfwd(on_cube(shared.frf))(one) for one in many]
    assert bool(((batched - torch.stack(single)).abs() < 1e-5 * scale).all())


def test_second_derivatives_are_those_of_a_direct_solve(plates) -> None:
    searched = {key: BOX[key] for key in ("plate.youngs_modulus", "wires.stiffness", "wires.viscous_damping")}
    model, shared, frequency = made(plates, MESHES["square"], searched, response=[3], reference=[8])
    position = torch.tensor([0.3, 0.6, 0.4], dtype=torch.float64)

    def size(frf):
        return lambda p: frf(model.space.to_si(p), frequency[3::9]).abs().log().sum()

    found, expected = hessian(size(shared.frf))(position), hessian(size(model.frf_direct))(position)
    assert bool(((found - expected).abs() < 1e-4 * expected.abs().max()).all())


def test_single_precision_is_for_values_alone(plates) -> None:
    model, shared, frequency = made(plates, MESHES["rectangle"])
    single, theta = shared.in_single_precision(), members(model, 4)
    with torch.no_grad():
        found, expected = single.frf(theta, frequency[1:]), shared.frf(theta, frequency[1:])
    assert found.dtype == torch.complex64
    assert 1e-9 < error(found, expected) < 2e-5
    # Where something may be differentiated, nothing has changed; the model it was made from has not either.
    assert torch.equal(single.frf(theta, frequency[1:]), expected)
    assert not shared.in_single
    with torch.no_grad():
        slopes = [jacfwd(lambda t, own=own: own.frf(t, frequency[1:4]).real)(theta[0]) for own in (single, shared)]
    assert slopes[0].dtype == torch.float64
    assert torch.equal(*slopes)


def test_single_precision_changes_nothing_where_members_share_no_modes(plates) -> None:
    searched = {"plate.poisson_ratio": Searched(0.2, 0.4)}
    model = plates.build(MESHES["rectangle"], {}, searched, response=[3], reference=[8], kind="accelerance")
    theta, frequency = members(model, 2), torch.linspace(5.0, 200.0, 20, dtype=torch.float64)
    with torch.no_grad():
        assert torch.equal(model.in_single_precision().frf(theta, frequency), model.frf(theta, frequency))
    model, shared, frequency = lump_anywhere()
    theta = members(model, 2)
    with torch.no_grad():
        assert torch.equal(shared.in_single_precision().frf(theta, frequency), shared.frf(theta, frequency))


def test_what_is_known_of_the_lines_is_kept_and_holds_for_the_whole_box(plates) -> None:
    model, shared, frequency = made(plates, MESHES["square"])
    own = shared.shared_modes
    own._stretches.clear()
    theta = members(model, 6)
    apart = torch.cat([shared.frf(member[None], frequency) for member in theta])
    assert len(own._stretches) == 1
    # The same stretches for every batch: what a member gets does not depend on who stands beside it.
    torch.testing.assert_close(shared.frf(theta, frequency), apart, rtol=1e-12, atol=1e-12 * float(apart.abs().max()))
    corners = model.space.to_si(torch.tensor([[0.0] * len(BOX), [1.0] * len(BOX)], dtype=torch.float64))
    assert error(shared.frf(corners, frequency[1:]), model.frf_direct(corners, frequency[1:])) < SERIES
    assert len(own._stretches) == 2
    for n_line in range(3, 3 + REMEMBERED):
        shared.frf(theta, frequency[:n_line])
    assert len(own._stretches) <= REMEMBERED


def test_members_beyond_the_box_get_stretches_of_their_own(plates, monkeypatch) -> None:
    model, shared, frequency = made(plates, MESHES["square"])
    asked = []
    around = shared_modes.Disc.around
    monkeypatch.setattr(shared_modes.Disc, "around", lambda z, value: asked.append(z.shape) or around(z, value))
    theta = members(model, 3)
    shared.frf(theta, frequency)
    first = len(asked)
    shared.frf(theta, frequency)
    assert len(asked) == first
    beyond = theta.clone()
    beyond[1, 0] = 3 * theta[1, 0]
    shared.frf(beyond, frequency)
    assert asked[first:] == [(3, len(frequency))]


def test_what_inference_mode_saw_can_be_differentiated_afterwards(plates) -> None:
    model, shared, frequency = made(plates, MESHES["rectangle"])
    shared.shared_modes._stretches.clear()
    theta = members(model, 2)
    with torch.inference_mode():
        seen = shared.frf(theta, frequency)
    position = theta.clone().requires_grad_()
    found = shared.frf(position, frequency)
    torch.testing.assert_close(seen.clone(), found.detach(), rtol=1e-4, atol=1e-6 * float(found.detach().abs().max()))
    (gradient,) = torch.autograd.grad(found.abs().square().sum(), position)
    assert bool(gradient.isfinite().all())
    place = torch.tensor([[0.61, 0.37]], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(shared.frf(theta, frequency, place).abs().square().sum(), place)
    assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("first", [jacrev, jacfwd, hessian], ids=lambda way: way.__name__)
def test_nothing_made_inside_a_transform_is_remembered(plates, first) -> None:
    searched = {key: BOX[key] for key in list(BOX)[:2]}
    model, shared, frequency = made(plates, Mesh(0.7, 0.4, 3, 2), searched, response=[3], reference=[8])
    lines, theta = frequency[1:4], members(model, 1)[0]
    for known in (model.mesh._known_deflection, shared.assembly._known_rows, shared.shared_modes._stretches):
        known.clear()
    slope = first(lambda t: shared.frf(t, lines).abs().log().sum())(theta)
    assert bool(slope.isfinite().all())
    assert not model.mesh._known_deflection
    assert not shared.assembly._known_rows
    assert not shared.shared_modes._stretches
    assert error(shared.frf(theta[None], lines), model.frf_direct(theta[None], lines)) < SERIES
    assert shared.shared_modes._stretches
    again = first(lambda t: shared.frf(t, lines).abs().log().sum())(theta)
    torch.testing.assert_close(again, slope, rtol=1e-9, atol=0)


def test_a_jacobian_is_the_same_by_batched_gradients_and_by_torch_func(plates) -> None:
    model, shared, frequency = made(plates, MESHES["rectangle"])
    theta = members(model, 1)[0]

    def real(t: torch.Tensor) -> torch.Tensor:
        return torch.view_as_real(shared.frf(t, frequency[1::8])).flatten()

    expected = jacrev(real)(theta)
    found = torch.autograd.functional.jacobian(real, theta, vectorize=True)
    assert bool(((found - expected).abs() <= 1e-9 * expected.abs().amax(0)).all())


def test_natural_frequencies_of_a_model_that_needs_no_matrix_are_those_of_all_dofs(plates) -> None:
    model, shared, _ = made(plates, MESHES["cantilever"])
    assert shared.assembly.uniform is None
    theta = members(model, 3)
    torch.testing.assert_close(
        shared.natural_frequencies(theta, 8), model.natural_frequencies(theta, 8), rtol=1e-7, atol=1e-6
    )


@SHAPES
def test_a_model_in_a_basis_has_the_same_frfs_in_the_modes_that_its_members_share(plates, mesh: Mesh) -> None:
    options = {"response": [3, (0.61, 0.37)], "reference": [8, 12, (0.83, 0.71)], "kind": "accelerance"}
    model = plates.build(mesh, {}, BOX, **options)
    frequency = torch.linspace(0.0, 6.3, 41, dtype=torch.float64) * plates.first_bending(mesh)
    middle = members(model, 1, seed=5)
    small = model.projected(ritz_basis(model, middle, frequency, 0, 3.0))
    shared = sharing_modes(small)
    assert shared is not None
    assert shared.shared_modes is not None
    theta = members(model, 6, seed=6)
    # Digits that strong springs and lumps take: see `reduced_basis.ROUNDING`.
    assert error(shared.frf(theta, frequency), small.frf(theta, frequency)) < 1e-8
    assert error(shared.frf(theta, frequency, decay=9.0), small.frf(theta, frequency, decay=9.0)) < 1e-8


def test_members_with_dampings_of_their_own_or_other_sections_share_no_modes_in_a_basis(plates) -> None:
    mesh = MESHES["rectangle"]
    options = {"response": [3], "reference": [8], "kind": "accelerance"}
    frequency = torch.linspace(0.0, 3.0, 7, dtype=torch.float64) * plates.first_bending(mesh)
    model = plates.build(mesh, {}, BOX, **options)
    assert sharing_modes(model) is None
    small = model.projected(ritz_basis(model, members(model, 1), frequency, 0, 2.0))
    assert sharing_modes(small) is not None
    assert sharing_modes(small.with_damping_factors(torch.full((4,), 1.2, dtype=torch.float64))) is None
    bent = plates.build(mesh, {}, BOX | {"plate.poisson_ratio": Searched(0.25, 0.35)}, **options)
    assert sharing_modes(bent.projected(ritz_basis(bent, members(bent, 1), frequency, 0, 2.0))) is None


def test_members_in_a_few_shared_modes_have_matrices_and_in_those_of_all_dofs_none(plates) -> None:
    """Natural frequencies come from matrices in a few modes; all dofs' are as many numbers again as the modes."""
    mesh = MESHES["rectangle"]
    model, shared, _ = made(plates, mesh)
    modes, whole = shared.shared_modes, shared.assembly.basis
    assert whole.shape[1] == whole.shape[0]
    few = whole[:, :40]
    inside = model.projected(few, modes)
    assert inside.assembly.uniform is not None
    assert model.projected(few, modes, matrices=False).assembly.uniform is None
    assert model.projected(whole, modes).assembly.uniform is None
    assert model.projected(whole).assembly.uniform is not None
