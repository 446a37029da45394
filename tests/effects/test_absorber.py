"""A mass on a spring against the same mass as a further coordinate, and against its limits."""

import numpy as np
import pytest
import scipy.linalg
import torch

from torchplate.effects import Absorber, GroundDashpot, GroundSpring, HystereticDamping, Plate, PointMass, SupportSpring
from torchplate.model import PlateModel, Searched, SparseModel, extrapolate, modes_at, reduce
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(15.0, 420.0, 82, dtype=torch.float64)
PLACE = {"absorber.x": 0.61, "absorber.y": 0.28}
TUNED = PLACE | {"absorber.mass": 0.05, "absorber.stiffness": 2.3e4, "absorber.viscous_damping": 1.7}
BARE = {
    "plate.youngs_modulus": 69e9,
    "plate.poisson_ratio": 0.31,
    "plate.density": 2710.0,
    "plate.thickness": 0.0031,
    "wires.stiffness": 4e3,
    "wires.viscous_damping": 2.0,
}
RECTANGLE, SQUARE = Mesh(0.52, 0.37, 6, 4), Mesh(0.43, 0.43, 5, 5)


def build(known: dict[str, float], mesh: Mesh = RECTANGLE, searched: dict | None = None, **more) -> PlateModel:
    kinds = {
        "absorber": Absorber, "mass": PointMass, "spring": GroundSpring, "dashpot": GroundDashpot, "loss":
        HystereticDamping,
    }  # fmt: skip
    used = {key.partition(".")[0] for key in [*known, *(searched or {})]}
    effects = {"plate": Plate(), "wires": SupportSpring(at=((0.21, 0.05), (0.66, 0.94)))}
    effects |= {label: kind() for label, kind in kinds.items() if label in used}
    numbers = {key: value for key, value in (BARE | known).items() if key not in (searched or {})}
    return PlateModel(mesh, effects, numbers, searched, **({"response": [3, (0.6, 0.7)], "reference": [8]} | more))


def explicit(model: PlateModel) -> tuple[np.ndarray, ...]:
    """K, M, C of plate and absorber, whose own deflection is the last coordinate."""
    bare = build({}, model.mesh)
    system = bare.system(NONE)
    row = bare.assembly.rows(bare.mesh.deflection_at(bare.mesh.places([(0.61, 0.28)])))[0].numpy()
    link = np.append(row, -1.0)
    viscous = (system.dashpot.mT @ (system.viscous[:, None] * system.dashpot)).numpy()
    whole = [
        scipy.linalg.block_diag(part, [[0.0]]) for part in (system.stiffness.numpy(), system.mass.numpy(), viscous)
    ]
    whole[0] += TUNED["absorber.stiffness"] * np.outer(link, link)
    whole[1][-1, -1] += TUNED["absorber.mass"]
    whole[2] += TUNED["absorber.viscous_damping"] * np.outer(link, link)
    return tuple(whole)


def distance(first: torch.Tensor, second: torch.Tensor) -> float:
    return float((first - second).norm() / second.norm())


@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_its_frf_is_that_of_a_further_coordinate(mesh: Mesh) -> None:
    model = build(TUNED, mesh)
    stiffness, mass, viscous = explicit(model)
    left, right = (
        np.pad(model.assembly.rows(mesh.deflection_at(mesh.places(points))).numpy(), ((0, 0), (0, 1)))
        for points in (model.response, model.reference)
    )
    omega = 2 * np.pi * LINES.numpy()[:, None, None]
    expected = left @ np.linalg.solve(
        stiffness + 1j * omega * viscous - omega**2 * mass, np.broadcast_to(right.T, (82, *right.T.shape))
    )
    # Rounding at the scale of the highest eigenvalue.
    assert distance(model.frf(NONE, LINES), torch.from_numpy(expected)) < 1e-9


def test_its_motion_is_one_of_the_natural_frequencies_that_are_listed() -> None:
    model = build(TUNED)
    stiffness, mass, _ = explicit(model)
    expected = np.sqrt(scipy.linalg.eigvalsh(stiffness, mass)[:12].clip(0)) / (2 * np.pi)
    # The least inertia of its link, (108 Hz / 200 kHz)² / 2 of a frequency, and rounding, of the zero above all.
    for found in (
        model.natural_frequencies(NONE, 12),
        model.modes(NONE).frequency[:12],
        modes_at(model, NONE[None], torch.tensor([[0.2, 0.3]]).double(), 12).frequency[0],
        SparseModel(model, NONE).modes(12, dense=True).frequency[:12],
        SparseModel(model, NONE).modes(12).frequency[:12],
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-3)
    # One more than the plate has up to there.
    below = build({}).natural_frequencies(NONE, 12)
    assert int((below < 300).sum()) + 1 == int((expected < 300).sum())


def test_without_a_mass_the_plate_has_its_own_natural_frequencies() -> None:
    found = build(TUNED | {"absorber.mass": 0.0}).natural_frequencies(NONE, 12)
    np.testing.assert_allclose(found, build({}).natural_frequencies(NONE, 12), rtol=1e-7, atol=1e-3)


def test_on_a_stiff_spring_it_is_a_point_mass_and_with_a_great_mass_a_spring_to_the_ground() -> None:
    rigid = build(TUNED | {"absorber.stiffness": 1e11}).frf(NONE, LINES)
    lump = build({"mass.x": 0.61, "mass.y": 0.28, "mass.mass": 0.05}).frf(NONE, LINES)
    # s²m/k of the highest line.
    assert distance(rigid, lump) < 1e-5
    heavy = build(TUNED | {"absorber.mass": 1e9}).frf(NONE, LINES)
    spring = {"spring.x": 0.61, "spring.y": 0.28, "spring.stiffness": 2.3e4}
    ground = build(spring | {"dashpot.x": 0.61, "dashpot.y": 0.28, "dashpot.viscous_damping": 1.7}).frf(NONE, LINES)
    assert distance(heavy, ground) < 1e-6


def test_it_splits_the_peak_to_which_it_is_tuned() -> None:
    bare = build({"loss.stiffness_loss_factor": 0.002})
    first = float(bare.natural_frequencies(NONE, 6)[3])
    mass = 0.02
    spring = mass * (2 * np.pi * first) ** 2
    tuned = build({"loss.stiffness_loss_factor": 0.002} | PLACE | {
        "absorber.x": 0.03, "absorber.y": 0.02, "absorber.mass": mass, "absorber.stiffness": spring,
        "absorber.viscous_damping": 1e-3,
    })  # fmt: skip
    around = tuned.natural_frequencies(NONE, 7)[3:5]
    assert float(around[0]) < first < float(around[1])


@pytest.mark.parametrize("in_place", [True, False], ids=["at a known place", "at a searched place"])
def test_it_works_with_shared_modes_and_their_error_is_told(in_place: bool) -> None:
    box = {
        "plate.youngs_modulus": Searched(6.6e10, 7.2e10),
        "absorber.mass": Searched(0.0, 0.1),
        "absorber.stiffness": Searched(1e4, 4e4, logarithmic=True),
        "absorber.viscous_damping": Searched(0.3, 3.0),
    }
    if not in_place:
        box |= {"absorber.x": Searched(0.55, 0.65), "absorber.y": Searched(0.2, 0.3)}
    model = build(TUNED, searched=box)
    found = reduce(model, LINES, tolerance=1e-4)
    assert found is not None
    small, error = found
    assert small.shared_modes is not None
    assert error <= 1e-4
    theta = box_of(model, 6)
    assert distance(small.frf(theta, LINES), model.frf_direct(theta, LINES)) < 1e-3  # ten times, as for every effect

    def real(evaluated: PlateModel, position: torch.Tensor) -> torch.Tensor:
        return torch.view_as_real(evaluated.frf(evaluated.space.to_si(position), LINES[::9])).square().sum().log()

    position = torch.full((len(box),), 0.4, dtype=torch.float64)
    slope, expected = (torch.func.grad(lambda p, m=m: real(m, p))(position) for m in (small, model))
    torch.testing.assert_close(slope, expected, rtol=2e-2, atol=1e-3 * float(expected.abs().max()))


def box_of(model: PlateModel, n: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(3)
    return model.space.to_si(torch.rand(n, len(model.names), dtype=torch.float64, generator=generator))


def test_on_an_extrapolated_mesh_sparse_and_dense_models_agree() -> None:
    model = extrapolate(build(TUNED), 300.0).model
    sparse = SparseModel(model, NONE)
    # Rounding of the correction, whose modes an iterative solver found.
    assert distance(sparse.frf(LINES), model.frf(NONE, LINES)) < 1e-7
    # The rows of all springs are not corrected in the listed frequencies: 0.2 % on a mesh as coarse as this.
    np.testing.assert_allclose(sparse.modes(8).frequency[:8], model.natural_frequencies(NONE, 8), rtol=4e-3, atol=1e-3)


def test_it_rides_on_a_base_that_moves() -> None:
    mesh = Mesh(0.52, 0.37, 6, 4, edges={"x0": "clamped"})
    model = build(TUNED, mesh, kind="transmissibility", reference=None)
    stiffness, mass, viscous = explicit(model)
    bare = build({}, mesh, kind="transmissibility", reference=None)
    load = bare.excitation(bare.plan(NONE), None)[0].numpy()
    # Relative to the base the absorber is loaded by its own inertia.
    load = np.append(load, TUNED["absorber.mass"])
    left = np.pad(model.assembly.rows(mesh.deflection_at(mesh.places(model.response))).numpy(), ((0, 0), (0, 1)))
    omega = 2 * np.pi * LINES.numpy()
    solved = [left @ np.linalg.solve(stiffness + 1j * w * viscous - w**2 * mass, load.astype(complex)) for w in omega]
    expected = 1 + omega[:, None] ** 2 * np.array(solved)
    for found in (model.frf(NONE, LINES), model.frf_direct(NONE, LINES)):
        assert distance(found[..., 0], torch.from_numpy(expected)) < 1e-9


def test_a_mass_on_rubber_is_looked_for():
    """A quarter of critical damping, of the heaviest mass on the stiffest spring."""
    plan = build(BARE).plan(NONE)
    high = {
        name: Absorber.parameters[name].prior_interval(plan.section, plan.geometry).high
        for name in ("mass", "stiffness", "viscous_damping")
    }
    critical = 2 * (high["mass"] * high["stiffness"]) ** 0.5
    assert high["viscous_damping"] / critical == pytest.approx(0.25)
