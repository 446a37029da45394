"""The model as users hold it: batches, chunks, labels, dtypes, and what it refuses."""

import copy

import numpy as np
import pytest
import torch

from torchplate.effects import CATALOGUE, HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel, Searched, ritz_basis
from torchplate.plate import Mesh

RECTANGLE = Mesh(0.7, 0.4, 5, 3)
SQUARE = Mesh(0.4, 0.4, 4, 4)
INTERVALS = {
    "plate.youngs_modulus": Searched(5e10, 9e10),
    "wires.stiffness": Searched(1e2, 1e4, logarithmic=True),
    "wires.viscous_damping": Searched(0.1, 30.0),
    "loss.stiffness_loss_factor": Searched(1e-4, 1e-2),
}


def members(model: PlateModel, *batch: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return model.space.to_si(torch.rand(*batch, len(model.names), generator=generator, dtype=torch.float64))


def lines(plates, mesh: Mesh, n_line: int = 13) -> torch.Tensor:
    return torch.linspace(0.5, 6.0, n_line, dtype=torch.float64) * plates.first_bending(mesh)


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_a_batch_answers_as_its_members_do(plates, relative_error, mesh: Mesh, loss_field: bool) -> None:
    searched = INTERVALS | ({"field.base": Searched(0.0, 0.1)} if loss_field else {})
    model = plates.build(mesh, {"lump.mass": 0.2}, searched, loss_field=loss_field)
    theta, frequency = members(model, 2, 3, seed=1), lines(plates, mesh)
    together = model.frf(theta, frequency, [3, (0.6, 0.7)], [7])
    assert together.shape == (2, 3, 13, 2, 1)
    for row in range(2):
        for column in range(3):
            alone = model.frf(theta[row, column], frequency, [3, (0.6, 0.7)], [7])
            # Rounding at the scale of the highest eigenvalue, in another order.
            assert relative_error(together[row, column], alone) < 1e-9
    # And the members are not one another.
    assert relative_error(together[0, 0], together[1, 2]) > 1e-2


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
def test_chunks_of_members_and_lines_change_no_number(plates, relative_error, loss_field: bool) -> None:
    searched = INTERVALS | ({"field.base": Searched(0.0, 0.1)} if loss_field else {})
    for mesh in (RECTANGLE, SQUARE):
        large, small = (
            plates.build(mesh, {"lump.mass": 0.2}, searched, loss_field=loss_field, memory=memory)
            for memory in (2**30, 1)
        )
        theta, frequency = members(large, 5, seed=2), lines(plates, mesh, 7)
        expected = large.frf(theta, frequency, [3], [7, 1])
        # Rounding at the scale of the highest eigenvalue, in another order.
        assert relative_error(small.frf(theta, frequency, [3], [7, 1]), expected) < 1e-9
        torch.testing.assert_close(
            small.natural_frequencies(theta, 8), large.natural_frequencies(theta, 8), rtol=1e-8, atol=0
        )


def test_no_batch_of_eigenproblems_is_larger_than_the_memory(plates, monkeypatch: pytest.MonkeyPatch) -> None:
    sound, sizes = torch.linalg.eigh, []

    def eigh(matrix: torch.Tensor, *args: object, **options: object):
        sizes.append(matrix.numel() * matrix.element_size())
        return sound(matrix, *args, **options)

    monkeypatch.setattr(torch.linalg, "eigh", eigh)
    model = plates.build(RECTANGLE, None, INTERVALS, memory=2**22)
    model.frf(members(model, 40, seed=3), lines(plates, RECTANGLE, 3), [3], [7])
    # 40 members of 72 dofs are 1.6 MB a matrix, and an evaluation needs several: two chunks or more, none alone.
    assert len(sizes) > 1
    assert 8 * 72**2 < max(sizes) < 2**21


def test_what_no_searched_parameter_touches_is_the_same_for_all_members(plates) -> None:
    model = plates.build(RECTANGLE, None, {"wires.viscous_damping": Searched(0.1, 30.0)})
    theta = members(model, 4, seed=4)
    system = model.system(theta)
    assert system.mass.shape == system.stiffness.shape == (72, 72)
    assert model.natural_frequencies(theta, 6).shape == (4, 6)
    assert model.frf(theta, lines(plates, RECTANGLE), [3], [7]).shape == (4, 13, 1, 1)
    assert model.frf_direct(theta, lines(plates, RECTANGLE), [3], [7]).shape == (4, 13, 1, 1)


def test_a_model_without_an_interval_takes_an_empty_theta(plates, relative_error) -> None:
    fixed = plates.build(RECTANGLE, {"plate.youngs_modulus": 6e10, "wires.stiffness": 500.0})
    assert fixed.names == ()
    model = plates.build(RECTANGLE, {"wires.stiffness": 500.0}, {"plate.youngs_modulus": Searched(5e10, 9e10)})
    theta, frequency = torch.tensor([6e10], dtype=torch.float64), lines(plates, RECTANGLE)
    expected = model.frf(theta, frequency, [3], [7])
    # The same numbers on the same way.
    assert relative_error(fixed.frf(plates.nothing, frequency, [3], [7]), expected) < 1e-12
    assert fixed.frf(torch.zeros(3, 0, dtype=torch.float64), frequency, [3], [7]).shape == (3, 13, 1, 1)
    assert fixed.natural_frequencies(torch.zeros(3, 0, dtype=torch.float64), 5).shape == (3, 5)


def test_a_refined_mesh_is_read_at_the_same_labels(plates, relative_error) -> None:
    frequency = lines(plates, RECTANGLE)
    known = plates.damping_of_every_kind(RECTANGLE)
    refined = plates.build(Mesh(0.7, 0.4, 3, 2, refine=2), known)
    fine = plates.build(Mesh(0.7, 0.4, 6, 4), known)
    # Node 2 of 3 × 2 is (1/3, 0): node 3 of 6 × 4. Node 7 is (2/3, 1/2): node 19.
    found, expected = refined.frf(plates.nothing, frequency, [2], [7]), fine.frf(plates.nothing, frequency, [3], [19])
    assert relative_error(found, expected) < 1e-9
    coarse = plates.build(Mesh(0.7, 0.4, 3, 2), known).frf(plates.nothing, frequency, [2], [7])
    # And the mesh matters.
    assert relative_error(coarse, expected) > 1e-2


def test_a_node_and_its_relative_place_are_one_point(plates, relative_error) -> None:
    model = plates.build(RECTANGLE, plates.damping_of_every_kind(RECTANGLE))
    frequency = lines(plates, RECTANGLE)
    by_node = model.frf(plates.nothing, frequency, [3, 24], [8])
    by_place = model.frf(plates.nothing, frequency, [(0.4, 0.0), (1.0, 1.0)], [(0.2, 1 / 3)])
    # Rounding of the places.
    assert relative_error(by_place, by_node) < 1e-9


def test_places_may_be_a_batch_of_a_transform_on_a_plate_with_a_hole_too(plates) -> None:
    """Of places that are numbers is asked whether they lie on the plate; of these nobody may ask."""
    lines = torch.tensor([40.0, 90.0], dtype=torch.float64)
    places = torch.tensor([[[0.31, 0.42]], [[0.9, 0.6]]], dtype=torch.float64)
    bare = plates.build(Mesh(0.5, 0.4, 5, 4))
    known = {name: value for name, value in bare.known_values.items() if name.startswith("plate.")}
    for cut in ((), ((0.4, 0.25, 0.6, 0.5),)):
        model = PlateModel(Mesh(0.5, 0.4, 5, 4, cut=cut), {"plate": bare.effects["plate"]}, known)

        def frf(at: torch.Tensor, model: PlateModel = model) -> torch.Tensor:
            return torch.view_as_real(model.frf(plates.nothing, lines, at, [2]))

        torch.testing.assert_close(torch.func.vmap(frf)(places), torch.stack([frf(one) for one in places]))
        slope = torch.func.jacrev(lambda at, frf=frf: frf(at).flatten())(places[0])[:, 0]
        moved = 1e-5 * torch.eye(2, dtype=torch.float64)
        expected = torch.stack(
            [(frf(places[0] + one) - frf(places[0] - one)).flatten() / 2e-5 for one in moved], dim=-1
        )
        torch.testing.assert_close(slope, expected, rtol=1e-6, atol=1e-8 * float(expected.abs().max()))


def test_points_and_kind_left_out_are_those_of_the_measurement(plates, relative_error) -> None:
    known, frequency = plates.damping_of_every_kind(RECTANGLE), lines(plates, RECTANGLE)
    measured = plates.build(RECTANGLE, known, response=[3], reference=[8, 21], kind="accelerance")
    bare = plates.build(RECTANGLE, known)
    expected = bare.frf(plates.nothing, frequency, [3], [8, 21], kind="accelerance")
    assert relative_error(measured.frf(plates.nothing, frequency), expected) == 0
    other = measured.frf(plates.nothing, frequency, reference=[5], kind="mobility")
    assert relative_error(other, bare.frf(plates.nothing, frequency, [3], [5], kind="mobility")) == 0


@pytest.mark.parametrize("kind", ["accelerance", "transmissibility"])
def test_sensors_and_hits_off_their_marks_read_what_is_there(plates, relative_error, kind: str) -> None:
    edges = {"x0": "clamped"} if kind == "transmissibility" else {}
    mesh = Mesh(0.7, 0.4, 5, 3, edges=edges)
    model, hits = plates.build(mesh, {"lump.mass": 0.2}, INTERVALS), [7, (0.35, 0.8)]
    model.response, model.kind = [3, (0.6, 0.7)], kind
    model.reference = hits if kind == "accelerance" else None
    theta, frequency = members(model, seed=3), lines(plates, mesh)
    response, reference = (
        torch.tensor(off, dtype=torch.float64) for off in ([[0.01, -0.02], [0, 0.03]], [[-0.02, 0.01], [0.015, 0]])
    )
    off = model.with_places_off(response, reference if model.reference else None)
    places = mesh.places([3, (0.6, 0.7)]) + response
    struck = mesh.places(hits) + reference if model.reference else None
    wanted = model.frf(theta, frequency, places, struck)
    assert relative_error(off.frf(theta, frequency), wanted) < 1e-12
    assert relative_error(off.frf_direct(theta, frequency), wanted) < 1e-9
    # Points that are asked for are where they are asked for; put back on its marks a model is as it was.
    given = hits if model.reference else None
    assert relative_error(off.frf(theta, frequency, [3, (0.6, 0.7)], given), model.frf(theta, frequency)) < 1e-12
    assert relative_error(off.with_places_off(None).frf(theta, frequency), model.frf(theta, frequency)) < 1e-12
    assert relative_error(wanted, model.frf(theta, frequency)) > 1e-3


def test_supports_off_their_marks_hold_what_is_there(plates, relative_error) -> None:
    """With what another effect changes of them at their marks; one that is not said to be off is on its mark."""
    mesh = Mesh(0.7, 0.4, 5, 3)
    known = {
        "plate.youngs_modulus": 7e10, "plate.poisson_ratio": 0.33, "plate.density": 2700.0, "plate.thickness": 0.003,
        "wires.stiffness": 2e3, "wires.viscous_damping": 3.0, "further.stiffness": 5e3, "further.viscous_damping": 1.0,
        "loss.stiffness_loss_factor": 0.01, "tight.factor_1": 1.4,
    }  # fmt: skip

    def hung(*at, tight) -> PlateModel:
        effects = {
            "plate": CATALOGUE["plate"](), "wires": CATALOGUE["support_spring"](at=at[:2]),
            "loss": CATALOGUE["hysteretic_damping"](), "further": CATALOGUE["support_spring"](at=at[2:]),
            "tight": CATALOGUE["support_asymmetry"](at=[tight]),
        }  # fmt: skip
        return PlateModel(mesh, effects, known, {}, [3], [7], "accelerance")

    marks = [(0.1, 0.2), (0.8, 0.1), (0.5, 0.9)]
    off = torch.tensor([[0.02, -0.01], [-0.03, 0.02]], dtype=torch.float64)
    moved = [tuple((torch.tensor(mark) + one).tolist()) for mark, one in zip(marks, off, strict=False)]
    frequency = lines(plates, mesh)
    nowhere = torch.zeros(1, 2, dtype=torch.float64)
    found = hung(*marks, tight=marks[1]).with_places_off(nowhere, nowhere, off)
    wanted = hung(*moved, marks[2], tight=moved[1]).frf(plates.nothing, frequency)
    assert relative_error(found.frf(plates.nothing, frequency), wanted) < 1e-6
    assert relative_error(hung(*marks, tight=marks[1]).frf(plates.nothing, frequency), wanted) > 1e-3


def test_a_response_may_sit_on_a_node_that_the_mesh_holds(plates) -> None:
    mesh = Mesh(0.7, 0.4, 5, 3, edges={"x0": "clamped"})
    found = plates.build(mesh).frf(plates.nothing, lines(plates, mesh), [1, 3], [7, 10])
    assert found[:, :, 0].abs().max() == 0 == found[:, 0].abs().max()
    assert found[:, 1, 1].abs().min() > 0


def test_the_plate_acts_first_wherever_it_stands() -> None:
    effects = {"wires": SupportSpring(nodes=[2, 9]), "loss": HystereticDamping(), "sheet": Plate()}
    known = {"sheet.poisson_ratio": 0.3, "sheet.density": 7860.0, "sheet.thickness": 0.002, "wires.stiffness": 1e3}
    intervals = {"sheet.youngs_modulus": Searched(1e11, 3e11), "loss.mass_loss_factor": Searched(0.0, 10.0)}
    model = PlateModel(RECTANGLE, effects, known, intervals)
    assert model.names == ("sheet.youngs_modulus", "loss.mass_loss_factor")
    assert model.units == ("Pa", "1/s²")
    theta = torch.tensor([2e11, 3.0], dtype=torch.float64)
    values = model.values(theta)
    assert values["sheet"]["youngs_modulus"].item() == 2e11
    assert values["sheet"]["thickness"].item() == 0.002
    assert values["wires"]["stiffness"].item() == 1e3
    assert values["wires"]["viscous_damping"].item() == 0.0
    assert values["loss"]["mass_loss_factor"].item() == 3.0
    assert values["loss"]["stiffness_loss_factor"].item() == 0.0


@pytest.mark.parametrize("loss_field", [False, True], ids=["proportional", "field"])
@pytest.mark.parametrize("mesh", [RECTANGLE, SQUARE], ids=["rectangle", "square"])
def test_results_have_the_precision_of_theta_and_the_model_keeps_its_own(
    plates, relative_error, mesh: Mesh, loss_field: bool
) -> None:
    known = plates.damping_of_every_kind(mesh) | ({"field.base": 0.02} if loss_field else {})
    model = plates.build(mesh, known, {"plate.youngs_modulus": Searched(5e10, 9e10)}, loss_field=loss_field)
    # Numbers that single precision holds exactly, so that the input is the same.
    theta, frequency = torch.tensor([[6e10], [8e10]]).double(), lines(plates, mesh).float().double()
    expected = model.frf(theta, frequency, [10], [7, (0.3, 0.6)])
    for single in (copy.deepcopy(model).float(), copy.deepcopy(model).to(torch.float16), model):
        assert single.known.dtype == single.space.low.dtype == torch.float64
        found = single.frf(theta.float(), frequency.float(), [10], [7, (0.3, 0.6)])
        assert found.dtype == torch.complex64
        assert single.natural_frequencies(theta.float(), 5).dtype == torch.float32
        assert single.frf_direct(theta.float(), frequency.float(), [10], [7]).dtype == torch.complex64
        assert single.modes(theta.float()).shape.dtype == torch.float32
        # The result is rounded to 6e-8 and nothing else is.
        assert relative_error(found.to(torch.complex128), expected) < 3e-7
        assert relative_error(single.frf(theta, frequency, [10], [7, (0.3, 0.6)]), expected) == 0


def test_a_network_in_single_precision_trains_through_the_model(plates) -> None:
    model = plates.build(RECTANGLE, None, INTERVALS)
    network = torch.nn.Sequential(torch.nn.Linear(2, len(INTERVALS)), torch.nn.Sigmoid()).float()
    whole = torch.nn.ModuleList([network, model]).float()
    theta = model.space.to_si(network(torch.tensor([[0.3, -0.7]])))
    model(theta, lines(plates, RECTANGLE), 3, 7).abs().log().sum().backward()
    gradient = whole[0][0].weight.grad
    assert gradient is not None
    assert gradient.dtype == torch.float32
    assert bool(torch.isfinite(gradient).all())
    assert float(gradient.abs().max()) > 0


def test_a_copy_takes_over_the_known_values_through_its_state(plates, relative_error) -> None:
    known = plates.damping_of_every_kind(RECTANGLE)
    model, twin = plates.build(RECTANGLE, known), plates.build(RECTANGLE, {"wires.stiffness": 77.0})
    frequency = lines(plates, RECTANGLE)
    expected = model.frf(plates.nothing, frequency, [3], [7])
    assert relative_error(twin.frf(plates.nothing, frequency, [3], [7]), expected) > 1e-2
    twin.load_state_dict(model.state_dict())
    assert relative_error(twin.frf(plates.nothing, frequency, [3], [7]), expected) == 0


def test_a_theta_of_another_length_is_refused(plates) -> None:
    model = plates.build(RECTANGLE, None, INTERVALS)
    for call in (
        lambda theta: model.frf(theta, torch.ones(1, dtype=torch.float64), [3], [7]),
        lambda theta: model.frf_direct(theta, torch.ones(1, dtype=torch.float64), [3], [7]),
        lambda theta: model.natural_frequencies(theta),
        lambda theta: model.modes(theta),
    ):
        with pytest.raises(ValueError, match=r"last dimension of 4 \(plate\.youngs_modulus, .*got 3\."):
            call(torch.ones(2, 3, dtype=torch.float64))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "inertance"}, r"one of receptance, mobility, accelerance, transmissibility, got 'inertance'"),
        ({"response": None}, r"Expected a response, got none.*Give response=\[node\]"),
        ({"reference": None}, r"Expected a reference, got none.*Give reference=\[node\]"),
        ({"response": [25]}, r"labels from 1 to 24 on a 5 × 3 mesh, got 25"),
        ({"reference": [(0.5, 1.5)]}, r"both from 0 to 1, got \[0\.5, 1\.5\]"),
    ],
)
def test_an_frf_that_cannot_be_says_what_to_mend(plates, change: dict, message: str) -> None:
    model = plates.build(RECTANGLE)
    frequency = torch.ones(1, dtype=torch.float64)
    for solve in (model.frf, model.frf_direct):
        with pytest.raises(ValueError, match=message):
            solve(plates.nothing, frequency, **({"response": [3], "reference": [7], "kind": "receptance"} | change))


SHEET = {"plate.youngs_modulus": 2e11, "plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.002}


@pytest.mark.parametrize(
    ("effects", "known", "searched", "message"),
    [
        ({"loss": HystereticDamping()}, {}, {}, r"exactly one effect `plate`"),
        ({"plate": Plate(), "other": Plate()}, SHEET, {}, r"exactly one effect `plate`"),
        ({"plate": Plate()}, SHEET | {"plate.youngs": 2e11}, {}, r"No parameter named 'plate\.youngs'\. The model has"),
        ({"plate": Plate()}, SHEET, {"wires.stiffness": Searched(1.0, 2.0)}, r"No parameter named 'wires\.stiffness'"),
        (
            {"plate": Plate()},
            {key: value for key, value in SHEET.items() if key != "plate.density"},
            {},
            r"'plate\.density' \[kg/m³\], got none\. Add it",
        ),
        (
            {"plate": Plate()},
            SHEET | {"plate.thickness": 0.0},
            {},
            r"'plate\.thickness' above 0 \[m\], got 0\. Correct",
        ),
        (
            {"plate": Plate()},
            {key: value for key, value in SHEET.items() if key != "plate.poisson_ratio"},
            {"plate.poisson_ratio": Searched(0.2, 0.6)},
            r"'plate\.poisson_ratio' from -0\.99 to 0\.499 \[-\], got 0\.6",
        ),
        (
            {"plate": Plate(), "wires": SupportSpring(nodes=[3])},
            SHEET | {"wires.stiffness": -1.0},
            {},
            r"'wires\.stiffness' at least 0 \[N/m\], got -1",
        ),
    ],
)
def test_a_model_that_cannot_be_says_what_to_mend(effects: dict, known: dict, searched: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlateModel(RECTANGLE, effects, known, searched)


class TestReplaced:
    @pytest.fixture
    def model(self, plates) -> PlateModel:
        return plates.build(RECTANGLE, {"lump.mass": 0.2}, INTERVALS, response=[3], reference=[7], kind="mobility")

    def frf(self, model: PlateModel, plates, theta) -> torch.Tensor:
        return model.frf(theta, lines(plates, RECTANGLE))

    def test_what_is_left_out_stays_as_it_is(self, plates, model) -> None:
        twin, theta = model.replaced(), members(model, seed=3)
        assert twin is not model
        assert twin.assembly is model.assembly
        assert (twin.effects, twin.known_values, twin.searched) == (model.effects, model.known_values, model.searched)
        assert twin.searched == INTERVALS
        assert twin.known_values["lump.mass"] == 0.2
        assert torch.equal(self.frf(twin, plates, theta), self.frf(model, plates, theta))

    def test_an_effect_that_goes_takes_its_numbers_along(self, model) -> None:
        kept = {label: effect for label, effect in model.effects.items() if label not in ("lump", "wires")}
        twin = model.replaced(effects=kept)
        assert set(twin.effects) == {"plate", "loss", "rayleigh"}
        assert list(twin.searched) == ["plate.youngs_modulus", "loss.stiffness_loss_factor"]
        assert not {"lump.mass", "wires.stiffness"} & twin.known_values.keys()
        # The first is as it was.
        assert list(model.searched) == list(INTERVALS)

    def test_an_effect_more_brings_numbers_of_its_own(self, plates, model) -> None:
        more = {**model.effects, "window": CATALOGUE["exponential_window"]()}
        twin = model.replaced(effects=more, known=model.known_values | {"window.rate": 3.0})
        theta = members(model, seed=4)
        decayed = model.frf(theta, lines(plates, RECTANGLE), decay=3.0)
        torch.testing.assert_close(self.frf(twin, plates, theta), decayed, rtol=1e-9, atol=0)

    def test_what_is_searched_now_is_known_no_more(self, model) -> None:
        mass = Searched(0.0, 1.0)
        twin = model.replaced(searched=model.searched | {"lump.mass": mass})
        assert twin.searched == {**INTERVALS, "lump.mass": mass}
        assert "lump.mass" not in twin.known_values
        assert twin.known_values.keys() == model.known_values.keys() - {"lump.mass"}

    def test_the_numbers_of_one_member_make_a_model_that_answers_as_it_does(self, plates, model) -> None:
        theta = members(model, seed=5)
        every = model.as_dict(theta)
        assert every == model.known_values | dict(zip(model.names, theta.tolist(), strict=True))
        fixed = model.replaced(known=every, searched={})
        assert fixed.names == ()
        assert torch.equal(self.frf(fixed, plates, plates.nothing), self.frf(model, plates, theta))

    def test_a_mesh_that_an_effect_has_split_is_split_once(self) -> None:
        effects = {"plate": Plate(), "finer": CATALOGUE["mesh_discretisation"](refine=3)}
        known = {"plate.youngs_modulus": 7e10, "plate.poisson_ratio": 0.3, "plate.density": 2700.0}
        twin = PlateModel(RECTANGLE, effects, known | {"plate.thickness": 2e-3}).replaced()
        assert twin.mesh.refine == 3
        assert list(twin.effects) == ["plate"]

    def test_a_number_of_nobody_is_refused(self, model) -> None:
        with pytest.raises(ValueError, match=r"No parameter named 'lump\.weight'"):
            model.replaced(known=model.known_values | {"lump.weight": 0.1})
        # What was searched and is neither searched nor known has no value.
        with pytest.raises(ValueError, match=r"a value or an interval for 'plate\.youngs_modulus'"):
            model.replaced(searched={})


@pytest.mark.parametrize("reduced", [False, True])
def test_the_state_of_a_model_is_its_numbers_and_no_matrix(plates, reduced) -> None:
    """What follows from mesh and effects is made anew: a state would hold it for every parameter that is saved."""
    model = plates.build(RECTANGLE, None, INTERVALS)
    if reduced:
        frequency = lines(plates, RECTANGLE)
        theta = model.space.to_si(torch.full((1, len(INTERVALS)), 0.5, dtype=torch.float64))
        model = model.projected(ritz_basis(model, theta, frequency, 0, 2.0))
    assert len(dict(model.named_buffers())) > 10
    assert set(model.state_dict()) == {"known", "space.low", "space.high", "space.logarithmic"}


@pytest.mark.parametrize(
    "own",
    [[np.int64(4)], np.array([4]), 4, torch.tensor([4]), torch.tensor([[0.75, 0.0]])],
    ids=("integers", "array", "label", "tensor", "places"),
)
def test_own_points_may_be_whatever_points_may_be(own):
    known = {"plate.youngs_modulus": 7e10, "plate.poisson_ratio": 0.3, "plate.density": 2700.0, "plate.thickness": 3e-3}
    lines, given = torch.tensor([50.0, 90.0], dtype=torch.float64), {"plate": Plate()}
    wanted = PlateModel(Mesh(0.5, 0.3, 4, 3), given, known, response=[4], reference=[2]).frf([], lines)
    model = PlateModel(Mesh(0.5, 0.3, 4, 3), given, known, response=own, reference=[2])
    assert torch.equal(model.frf([], lines), wanted)
    # Points that are given anew count, whatever was asked for before.
    model.response = [7]
    assert not torch.equal(model.frf([], lines), wanted)
