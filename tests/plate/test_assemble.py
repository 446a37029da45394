"""The assembled matrices against a loop over elements, and against what a plate must do whatever its mesh."""

import copy

import numpy as np
import pytest
import torch

from torchplate.plate import Assembly, Geometry, Local, Mesh, Proportional, Section, Sprung, assemble
from torchplate.plate.transforms import REMEMBERED

SIDES = (0.7, 0.3)
MESHES = {
    "free": Mesh(*SIDES, 4, 3),
    "refined": Mesh(*SIDES, 2, 1, refine=2),
    "held": Mesh(*SIDES, 4, 3, edges={"x0": "clamped", "y1": "simply_supported"}),
    "square": Mesh(0.4, 0.4, 3, 3),
}


def number(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


def geometry_of(mesh: Mesh) -> Geometry:
    return Geometry(number(mesh.length_x), number(mesh.length_y))


def random_rigidity(*batch: int, seed: int) -> torch.Tensor:
    """Full and positive definite, another one in every element [N m]."""
    factor = torch.randn(*batch, 3, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return 50 * (factor @ factor.mT + 0.2 * torch.eye(3, dtype=torch.float64))


def random_areal_mass(*batch: int, seed: int) -> torch.Tensor:
    return 5 + 20 * torch.rand(*batch, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def field_dofs(mesh: Mesh, power_x: int, power_y: int) -> torch.Tensor:
    """The dofs of (x/Lx)^p (y/Ly)^q at every node, per relative length as the mesh has them."""
    x, y = mesh.node_place.unbind(-1)
    slope_x = power_x * x ** max(power_x - 1, 0) * y**power_y
    slope_y = power_y * x**power_x * y ** max(power_y - 1, 0)
    return torch.stack([x**power_x * y**power_y, slope_y, -slope_x], dim=-1).flatten()


@pytest.mark.parametrize("name", list(MESHES))
@pytest.mark.check
def test_fields_over_the_elements_assemble_as_a_loop_over_the_elements_does(reference, name: str) -> None:
    mesh = MESHES[name]
    rigidity, areal_mass = random_rigidity(mesh.n_element, seed=1), random_areal_mass(mesh.n_element, seed=2)
    assembly, geometry = Assembly(mesh), geometry_of(mesh)
    expected = reference.assembly(mesh, mesh.length_x, mesh.length_y, rigidity.numpy(), areal_mass.numpy())
    found = assembly.stiffness(rigidity, geometry), assembly.mass(areal_mass, geometry)
    for matrix, by_loop in zip(found, expected, strict=True):
        assert matrix.shape == (assembly.size, assembly.size) == (len(mesh.free_dof),) * 2
        # The loop inverts A in metres and loses a few digits to its condition.
        np.testing.assert_allclose(matrix.numpy(), by_loop, rtol=0, atol=1e-11 * np.abs(by_loop).max())


@pytest.mark.parametrize("name", list(MESHES))
@pytest.mark.check
def test_sides_that_differ_from_the_nominal_ones_stretch_every_element(reference, name: str) -> None:
    mesh, sides = MESHES[name], (0.5, 0.8)
    rigidity, areal_mass = random_rigidity(mesh.n_element, seed=3), random_areal_mass(mesh.n_element, seed=4)
    assembly, geometry = Assembly(mesh), Geometry(number(sides[0]), number(sides[1]))
    expected = reference.assembly(mesh, *sides, rigidity.numpy(), areal_mass.numpy())
    found = assembly.stiffness(rigidity, geometry), assembly.mass(areal_mass, geometry)
    for matrix, by_loop in zip(found, expected, strict=True):
        # As above.
        np.testing.assert_allclose(matrix.numpy(), by_loop, rtol=0, atol=1e-11 * np.abs(by_loop).max())


@pytest.mark.parametrize("name", list(MESHES))
def test_a_uniform_section_gives_what_equal_elements_give(name: str) -> None:
    mesh = MESHES[name]
    assembly, geometry = Assembly(mesh), geometry_of(mesh)
    rigidity, areal_mass = random_rigidity(2, 1, seed=5), random_areal_mass(2, 1, seed=6)
    stiffness = assembly.stiffness(rigidity.expand(2, mesh.n_element, 3, 3), geometry)
    mass = assembly.mass(areal_mass.expand(2, mesh.n_element), geometry)
    # The same sums in another order.
    torch.testing.assert_close(
        assembly.stiffness(rigidity, geometry), stiffness, rtol=0, atol=1e-13 * stiffness.abs().max().item()
    )
    torch.testing.assert_close(assembly.mass(areal_mass, geometry), mass, rtol=0, atol=1e-13 * mass.abs().max().item())


@pytest.mark.parametrize("n_element", [1, 12], ids=["uniform", "field"])
def test_a_batch_assembles_as_its_members_do(n_element: int) -> None:
    mesh = MESHES["held"]
    assembly = Assembly(mesh)
    rigidity = random_rigidity(2, 3, n_element, seed=7)
    areal_mass = random_areal_mass(2, 3, n_element, seed=8)
    length_x = torch.tensor([[0.5, 0.6, 0.7], [0.3, 0.2, 0.9]], dtype=torch.float64)
    length_y = torch.tensor([0.4, 0.35, 0.3], dtype=torch.float64).expand(2, 3)
    stiffness = assembly.stiffness(rigidity, Geometry(length_x, length_y))
    mass = assembly.mass(areal_mass, Geometry(length_x, length_y))
    load = assembly.translation_load(areal_mass, Geometry(length_x, length_y))
    assert stiffness.shape == mass.shape == (2, 3, assembly.size, assembly.size)
    assert load.shape == (2, 3, assembly.size)
    for member in [(0, 0), (0, 2), (1, 1)]:
        own = Geometry(length_x[member], length_y[member])
        for batch, single in (
            (stiffness, assembly.stiffness(rigidity[member], own)),
            (mass, assembly.mass(areal_mass[member], own)),
            (load, assembly.translation_load(areal_mass[member], own)),
        ):
            # The same sums in another order.
            torch.testing.assert_close(batch[member], single, rtol=0, atol=1e-13 * single.abs().max().item())


def test_sides_of_a_batch_meet_a_section_without_one() -> None:
    mesh = MESHES["free"]
    assembly = Assembly(mesh)
    rigidity, areal_mass = random_rigidity(mesh.n_element, seed=9), random_areal_mass(mesh.n_element, seed=10)
    geometry = Geometry(torch.tensor([0.5, 0.6], dtype=torch.float64), torch.tensor([0.4, 0.3], dtype=torch.float64))
    stiffness, mass = assembly.stiffness(rigidity, geometry), assembly.mass(areal_mass, geometry)
    own = Geometry(geometry.length_x[1], geometry.length_y[1])
    # The same sums in another order.
    torch.testing.assert_close(
        stiffness[1], assembly.stiffness(rigidity, own), rtol=0, atol=1e-13 * stiffness.abs().max().item()
    )
    torch.testing.assert_close(mass[1], assembly.mass(areal_mass, own), rtol=0, atol=1e-13 * mass.abs().max().item())


def test_rigid_motions_weigh_the_plate_and_its_moments() -> None:
    mesh, density_thickness = MESHES["free"], 7860 * 0.0027
    length_x, length_y = SIDES
    mass = Assembly(mesh).mass(number(density_thickness)[None], geometry_of(mesh))
    rigid = torch.stack([field_dofs(mesh, 0, 0), field_dofs(mesh, 1, 0), field_dofs(mesh, 0, 1)])
    assert torch.equal(rigid[0], mesh.rigid_translation)
    total = density_thickness * length_x * length_y
    expected = total * torch.tensor(
        [[1, 1 / 2, 1 / 2], [1 / 2, 1 / 3, 1 / 4], [1 / 2, 1 / 4, 1 / 3]], dtype=torch.float64
    )
    # The element holds these fields exactly: rounding of a sum over all dofs.
    torch.testing.assert_close(rigid @ mass @ rigid.mT, expected, rtol=1e-12, atol=0)


def test_the_total_mass_is_that_of_all_elements_together() -> None:
    mesh = MESHES["free"]
    areal_mass = random_areal_mass(mesh.n_element, seed=11)
    mass = Assembly(mesh).mass(areal_mass, geometry_of(mesh))
    expected = areal_mass.mean() * SIDES[0] * SIDES[1]
    # Rounding of a sum over all dofs.
    torch.testing.assert_close(mesh.rigid_translation @ mass @ mesh.rigid_translation, expected, rtol=1e-12, atol=0)


@pytest.mark.parametrize("n_element", [1, 12], ids=["uniform", "field"])
@pytest.mark.parametrize("name", ["free", "held"])
def test_the_translation_load_is_the_inertia_of_the_whole_plate(name: str, n_element: int) -> None:
    mesh = MESHES[name]
    areal_mass = random_areal_mass(n_element, seed=12)
    whole = Assembly(MESHES["free"]).mass(areal_mass, geometry_of(mesh))
    load = Assembly(mesh).translation_load(areal_mass, geometry_of(mesh))
    # Held dofs move with the base and push on the free ones: they are in the product, not in the rows.
    expected = (whole @ mesh.rigid_translation)[mesh.free_dof]
    torch.testing.assert_close(load, expected, rtol=0, atol=1e-13 * expected.abs().max().item())
    if name == "free":
        total = areal_mass.mean() * SIDES[0] * SIDES[1]
        torch.testing.assert_close(load @ mesh.rigid_translation, total, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", ["free", "refined", "square"])
def test_translation_and_two_tilts_are_the_only_motions_without_energy(name: str) -> None:
    mesh = MESHES[name]
    stiffness = Assembly(mesh).stiffness(random_rigidity(mesh.n_element, seed=13), geometry_of(mesh))
    # Neighbours' terms add up in one order here and in another across the diagonal.
    assert (stiffness - stiffness.mT).abs().max() < 1e-14 * stiffness.abs().max()
    rigid = torch.stack([field_dofs(mesh, 0, 0), field_dofs(mesh, 1, 0), field_dofs(mesh, 0, 1)], dim=-1)
    # Rounding of twelve terms of the size of the largest entry.
    assert (stiffness @ rigid).abs().max() < 1e-13 * stiffness.abs().max()
    energy = torch.linalg.eigvalsh(stiffness)
    assert energy[:3].abs().max() < 1e-13 * energy[-1]
    assert energy[3] > 1e-7 * energy[-1]


@pytest.mark.parametrize("name", ["free", "refined", "square"])
def test_a_constant_curvature_passes_through_a_patch_of_elements(name: str) -> None:
    mesh = MESHES[name]
    rigidity = random_rigidity(1, seed=14)
    stiffness = Assembly(mesh).stiffness(rigidity, geometry_of(mesh))
    # w = 0.3 + x/Lx − 2 y/Ly + three curvatures that all differ.
    parts = {(0, 0): 0.3, (1, 0): 1.0, (0, 1): -2.0, (2, 0): 0.8, (0, 2): -0.5, (1, 1): 1.7}
    exact = sum(factor * field_dofs(mesh, *power) for power, factor in parts.items())
    inner = ((mesh.node_place > 0.01) & (mesh.node_place < 0.99)).all(-1).repeat_interleave(3)
    # No force inside: the patch test of a non-conforming element. Rounding against the largest element force.
    force = stiffness @ exact
    assert force[inner].abs().max() < 1e-12 * force.abs().max()
    # And with the rim held on the exact field, the inside finds it.
    load = -(stiffness[inner][:, ~inner] @ exact[~inner])
    found = torch.linalg.solve(stiffness[inner][:, inner], load)
    torch.testing.assert_close(found, exact[inner], rtol=0, atol=1e-11)
    length_x, length_y = mesh.length_x, mesh.length_y
    curvature = -torch.tensor(
        [2 * 0.8 / length_x**2, 2 * -0.5 / length_y**2, 2 * 1.7 / (length_x * length_y)], dtype=torch.float64
    )
    energy = 0.5 * curvature @ rigidity[0] @ curvature * length_x * length_y
    torch.testing.assert_close(0.5 * exact @ force, energy, rtol=1e-11, atol=0)


@pytest.mark.parametrize("n_element", [1, 12], ids=["uniform", "field"])
@pytest.mark.parametrize("by_element", [False, True], ids=["projected anew", "each element once"])
def test_a_reduced_basis_gives_the_projection_of_the_full_matrices(n_element: int, by_element: bool) -> None:
    mesh = MESHES["held"]
    full, geometry = Assembly(mesh), geometry_of(mesh)
    basis = torch.randn(full.size, 7, generator=torch.Generator().manual_seed(15), dtype=torch.float64)
    reduced = Assembly(mesh, basis, by_element)
    assert reduced.size == 7
    assert (reduced.elements is not None) == by_element
    # All of it follows from mesh and basis: there is no state to keep.
    assert not reduced.state_dict()
    rigidity, areal_mass = random_rigidity(2, n_element, seed=16), random_areal_mass(2, n_element, seed=17)
    rows = mesh.deflection_at(mesh.places([8, (0.33, 0.6)]))
    for found, expected in (
        (reduced.stiffness(rigidity, geometry), basis.mT @ full.stiffness(rigidity, geometry) @ basis),
        (reduced.mass(areal_mass, geometry), basis.mT @ full.mass(areal_mass, geometry) @ basis),
        (
            reduced.translation_load(areal_mass, geometry),
            full.translation_load(areal_mass, geometry) @ basis,
        ),
        (reduced.rows(rows), full.rows(rows) @ basis),
    ):
        # The same sums in another order.
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-12 * expected.abs().max().item())


@pytest.mark.parametrize("name", list(MESHES))
def test_the_rows_of_each_element_are_its_dofs_and_zero_where_they_are_held(name: str) -> None:
    mesh = MESHES[name]
    whole, motion = Assembly(mesh), torch.zeros(mesh.n_dof, dtype=torch.float64)
    motion[mesh.free_dof] = torch.randn(len(mesh.free_dof), generator=torch.Generator().manual_seed(4)).double()
    assert torch.equal(whole.element_rows() @ motion[mesh.free_dof], motion[mesh.element_dof])


def test_a_row_over_the_dofs_loses_its_held_ones() -> None:
    mesh = MESHES["held"]
    row = torch.arange(float(mesh.n_dof), dtype=torch.float64)[None]
    assert torch.equal(Assembly(mesh).rows(row)[0].long(), mesh.free_dof)


def uniform_section(**change: torch.Tensor) -> Section:
    one = torch.ones(1, dtype=torch.float64)
    own = {
        "youngs_modulus": 70e9 * one,
        "young_ratio": one,
        "poisson_ratio": 0.33 * one,
        "shear_factor": one,
        "density": 2700 * one,
        "thickness": 0.004 * one,
        "stiffness_factor": one[:, None],
    }
    return Section(**(own | change))


def test_elements_without_a_loss_of_their_own_lose_nothing_and_others_that_part_of_their_rigidity() -> None:
    plain = uniform_section()
    assert float(plain.lossy_rigidity.abs().max()) == 0
    lossy = uniform_section(loss_factor=torch.tensor([[0.03]], dtype=torch.float64))
    torch.testing.assert_close(lossy.lossy_rigidity, 0.03 * plain.rigidity, rtol=1e-14, atol=0)


def test_the_rigidity_of_an_isotropic_section_is_that_of_the_paper() -> None:
    # Eq. 12 with numbers put in by hand.
    flexural = 70e9 * 0.004**3 / (12 * (1 - 0.33**2))
    expected = flexural * torch.tensor([[1, 0.33, 0], [0.33, 1, 0], [0, 0, 0.335]], dtype=torch.float64)
    torch.testing.assert_close(uniform_section().rigidity[0], expected, rtol=1e-14, atol=0)
    torch.testing.assert_close(uniform_section().areal_mass, torch.tensor([10.8], dtype=torch.float64))


def test_an_orthotropic_section_keeps_the_mean_modulus_and_its_parts() -> None:
    one = torch.ones(1, dtype=torch.float64)
    rigidity = uniform_section(
        young_ratio=0.16 * one, shear_factor=1.5 * one, stiffness_factor=0.9 * one[:, None]
    ).rigidity[0]
    # E_x = 70/0.4 GPa, E_y = 70 · 0.4 GPa, ν_x = ν √(E_x/E_y); compliance inverted by hand: E_x ν_y = ν √(E_x E_y).
    young_x, young_y, poisson = 70e9 / 0.4, 70e9 * 0.4, 0.33
    compliance = torch.tensor(
        [
            [1 / young_x, -poisson / 70e9, 0],
            [-poisson / 70e9, 1 / young_y, 0],
            [0, 0, 2 * (1 + poisson) / (1.5 * 70e9)],
        ],
        dtype=torch.float64,
    )
    expected = 0.9 * 0.004**3 / 12 * torch.linalg.inv(compliance)
    torch.testing.assert_close(rigidity, expected, rtol=1e-12, atol=1e-9)


def test_local_terms_add_their_row_times_itself() -> None:
    mesh = MESHES["held"]
    assembly, geometry = Assembly(mesh), geometry_of(mesh)
    rows = mesh.deflection_at(mesh.places([8, (0.33, 0.6), 13]))
    mass = torch.tensor([0.1, 0.2], dtype=torch.float64)
    stiffness = torch.tensor([[1e3, 2e3, 3e3], [4e3, 5e3, 6e3]], dtype=torch.float64)
    viscous = torch.tensor([[1.0], [2.0]], dtype=torch.float64)
    terms = [Local(rows[:2], mass=mass), Local(rows, stiffness=stiffness), Local(rows[2:], viscous=viscous)]
    bare = assembly.system(uniform_section(), geometry, [], [])
    system = assembly.system(uniform_section(), geometry, terms, [])
    free = rows[:, mesh.free_dof]
    for member in range(2):
        added = sum(k * torch.outer(u, u) for k, u in zip(stiffness[member], free, strict=True))
        torch.testing.assert_close(
            system.stiffness[member], bare.stiffness + added, rtol=0, atol=1e-13 * bare.stiffness.max().item()
        )
    added = sum(m * torch.outer(u, u) for m, u in zip(mass, free, strict=False))
    torch.testing.assert_close(system.mass, bare.mass + added, rtol=0, atol=1e-14)
    assert bare.dashpot.shape == (0, assembly.size)
    assert bare.hysteretic is None
    torch.testing.assert_close(system.dashpot.expand(2, 1, -1)[0], free[2:], rtol=0, atol=0)
    torch.testing.assert_close(system.viscous, viscous, rtol=0, atol=0)


def test_the_dynamic_stiffness_of_terms_is_that_of_their_parts() -> None:
    rows = MESHES["free"].deflection_at(MESHES["free"].places([8, 13]))
    mass, stiffness, viscous = (
        torch.tensor(pair, dtype=torch.float64) for pair in ((0.1, 0.2), (1e3, 2e3), (3.0, 4.0))
    )
    s = torch.tensor([0.0, 20j, 300j - 2.0], dtype=torch.complex128)
    found = Local(rows, mass=mass, stiffness=stiffness, viscous=viscous).dynamic_stiffness(s)
    expected = stiffness[:, None] + s * viscous[:, None] + s**2 * mass[:, None]
    torch.testing.assert_close(found, expected, rtol=1e-14, atol=0)
    # A mass that hangs on a spring and a dashpot: both in a row, and what else is there beside them.
    hung = Local(rows, stiffness=stiffness, sprung=Sprung(mass, stiffness, viscous)).dynamic_stiffness(s[1:])
    link = 1 / (stiffness[:, None] + s[1:] * viscous[:, None])
    torch.testing.assert_close(
        hung, stiffness[:, None] + 1 / (link + 1 / (s[1:] ** 2 * mass[:, None])), rtol=1e-12, atol=0
    )
    assert not bool(Local(rows).dynamic_stiffness(s).any())


def test_dashpots_of_several_effects_stand_one_after_the_other() -> None:
    mesh = MESHES["free"]
    rows = mesh.deflection_at(mesh.places([8, 13, 20]))
    terms = [
        Local(rows[:1], viscous=torch.tensor([[1.0], [2.0]], dtype=torch.float64)),
        Local(rows[1:], viscous=torch.tensor([3.0, 4.0], dtype=torch.float64)),
    ]
    system = Assembly(mesh).system(uniform_section(), geometry_of(mesh), terms, [])
    expected = torch.tensor([[1, 3, 4], [2, 3, 4]], dtype=torch.float64)
    torch.testing.assert_close(system.viscous, expected, rtol=0, atol=0)
    torch.testing.assert_close(system.dashpot, rows, rtol=0, atol=0)


def test_a_loss_of_single_elements_is_their_stiffness_in_quadrature() -> None:
    mesh = MESHES["held"]
    assembly, geometry = Assembly(mesh), geometry_of(mesh)
    loss = torch.rand(mesh.n_element, generator=torch.Generator().manual_seed(18), dtype=torch.float64)
    system = assembly.system(uniform_section(loss_factor=loss[:, None]), geometry, [], [])
    rigidity = uniform_section().rigidity * loss[:, None, None]
    assert system.hysteretic is not None
    torch.testing.assert_close(
        system.hysteretic, assembly.stiffness(rigidity, geometry), rtol=0, atol=1e-12 * rigidity.max().item()
    )


def test_damping_of_several_effects_adds_up() -> None:
    mesh = MESHES["free"]
    damping = [
        Proportional(stiffness_loss_factor=number(0.01), mass_loss_factor=number(2.0)),
        Proportional(stiffness_loss_factor=number(0.02), mass_coefficient=number(3.0)),
        Proportional(stiffness_coefficient=number(1e-5), loss_exponent=number(0.2)),
        Proportional(loss_exponent=number(0.3)),
    ]
    found = Assembly(mesh).system(uniform_section(), geometry_of(mesh), [], damping).proportional
    assert [float(part) for part in found] == pytest.approx([0.03, 2.0, 3.0, 1e-5, 0.5], rel=1e-15)


def test_without_matrices_of_all_dofs_at_hand_the_answer_is_the_same() -> None:
    mesh = Mesh(0.4, 0.3, 3, 2)
    geometry = Geometry(*(torch.tensor(side, dtype=torch.float64) for side in (0.4, 0.3)))
    often, seldom = Assembly(mesh), Assembly(mesh, dense=False)
    assert often.uniform is not None
    assert seldom.uniform is None
    section = uniform_section()
    for one, other in zip(
        often.system(section, geometry, [], [])[:2], seldom.system(section, geometry, [], [])[:2], strict=True
    ):
        torch.testing.assert_close(one, other, rtol=0, atol=1e-14 * float(one.abs().max()))


@pytest.mark.parametrize("by_element", [False, True], ids=["projected anew", "each element once"])
@pytest.mark.parametrize("batch", [(), (3,)], ids=["alone", "batch"])
def test_a_patch_costs_its_own_elements_and_gives_what_all_elements_do(batch, by_element, monkeypatch) -> None:
    mesh = MESHES["free"]
    geometry = geometry_of(mesh)
    full = Assembly(mesh)
    basis = torch.randn(full.size, 7, generator=torch.Generator().manual_seed(19), dtype=torch.float64)
    reduced = Assembly(mesh, basis, by_element)
    rigidity = random_rigidity(*batch, 1, seed=20).expand(*batch, mesh.n_element, 3, 3).clone()
    if batch:
        # Each member has a patch of its own.
        rigidity[0, 4] *= 0.6
        rigidity[2, 7] *= 1.3
    else:
        rigidity[[4, 7]] *= 0.6
    counted = []
    inner = assemble._few
    monkeypatch.setattr(assemble, "_few", lambda given: counted.append(inner(given)) or inner(given))
    found = reduced.stiffness(rigidity, geometry)
    (some,) = counted
    assert some.tolist() == [4, 7]
    torch.testing.assert_close(
        found, basis.mT @ full.stiffness(rigidity, geometry) @ basis, rtol=0, atol=1e-12 * found.abs().max().item()
    )
    # Where most elements differ, all of them are summed; and where nobody may look.
    counted.clear()
    reduced.stiffness(random_rigidity(*batch, mesh.n_element, seed=21), geometry)
    assert counted == [None]
    if batch:
        each = torch.vmap(lambda one: reduced.stiffness(one, geometry))(rigidity)
        torch.testing.assert_close(each, found, rtol=0, atol=1e-12 * found.abs().max().item())


# Forward mode loads its own rules by torch.jit.script, which warns of itself.
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
@pytest.mark.parametrize("by_element", [False, True], ids=["projected anew", "each element once"])
def test_a_patch_that_changes_nothing_yet_has_its_slope(by_element: bool) -> None:
    mesh = MESHES["free"]
    full, geometry = Assembly(mesh), geometry_of(mesh)
    basis = torch.randn(full.size, 7, generator=torch.Generator().manual_seed(24), dtype=torch.float64)
    reduced, where = Assembly(mesh, basis, by_element), torch.zeros(mesh.n_element, dtype=torch.float64)
    where[[0, 5]] = 1.0
    alike = random_rigidity(1, seed=25)

    def stiffness(factor: torch.Tensor) -> torch.Tensor:
        return reduced.stiffness((1 + (factor - 1) * where)[:, None, None] * alike, geometry)

    # The stiffness goes with the factor along a straight line.
    expected = stiffness(number(2.0)) - stiffness(number(1.0))
    backward = torch.autograd.functional.jacobian(stiffness, number(1.0))
    _, forward = torch.func.jvp(stiffness, (number(1.0),), (number(1.0),))
    each = torch.vmap(torch.func.jacfwd(stiffness))(torch.ones(2, dtype=torch.float64))
    for slope in (backward, forward, *each):
        torch.testing.assert_close(slope, expected, rtol=0, atol=1e-12 * expected.abs().max().item())


def test_patches_in_different_places_cost_each_member_its_own_elements(monkeypatch) -> None:
    mesh = MESHES["free"]
    geometry = geometry_of(mesh)
    full = Assembly(mesh)
    basis = torch.randn(full.size, 7, generator=torch.Generator().manual_seed(22), dtype=torch.float64)
    reduced = Assembly(mesh, basis)
    # One patch in each element, the first as well, of 2 × 6 members: together they are everywhere.
    factor = 1 - 0.4 * torch.eye(mesh.n_element, dtype=torch.float64).reshape(2, 6, mesh.n_element)
    rigidity = factor[..., None, None] * random_rigidity(1, seed=23)
    counted = []
    inner = Assembly._project
    monkeypatch.setattr(
        Assembly, "_project", lambda self, given, some=None: counted.append(given.shape[-3]) or inner(self, given, some)
    )
    found = reduced.stiffness(rigidity, geometry)
    assert counted == [1] * 12
    expected = basis.mT @ full.stiffness(rigidity, geometry) @ basis
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12 * found.abs().max().item())


def test_rows_in_a_basis_are_made_once_for_places_that_stay_and_anew_in_another_basis() -> None:
    mesh = Mesh(0.7, 0.4, 4, 3)
    basis = torch.rand(len(mesh.free_dof), 5, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    assembly = Assembly(mesh, basis)
    vector = mesh.deflection_at(mesh.places([8, 13]))
    first = assembly.rows(vector)
    assert assembly.rows(vector) is first
    torch.testing.assert_close(first, vector[:, mesh.free_dof] @ basis)
    # Another tensor in the same place in memory's book is another one.
    other = vector.clone()
    torch.testing.assert_close(assembly.rows(2 * other), 2 * first)
    assert assembly.rows(vector.clone().requires_grad_()).requires_grad
    twin = copy.copy(assembly)
    twin._buffers = dict(assembly._buffers)
    twin.seen, twin.everywhere = 3 * basis, 3 * assembly.everywhere
    torch.testing.assert_close(twin.rows(vector), 3 * first)
    assert torch.equal(assembly.rows(vector), first)
    for _ in range(2 * REMEMBERED):
        assembly.rows(torch.ones_like(vector))
    assert len(assembly._known_rows) <= REMEMBERED
