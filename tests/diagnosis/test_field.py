"""A field without a name: its columns, its strength, and kind and place of what is really there."""

from dataclasses import replace

import pytest
import torch

from torchplate.diagnosis.field.aside import Aside, put_aside
from torchplate.diagnosis.field.descent import FieldDescent, Place, part_left
from torchplate.diagnosis.field.field_model import FieldModel
from torchplate.diagnosis.field.grid import Grid
from torchplate.diagnosis.field.infer import infer_field, with_field
from torchplate.diagnosis.field.strength import Products, _solved, cross_validated, forms, solved
from torchplate.diagnosis.judged import judged_at
from torchplate.diagnosis.lines import every_nth
from torchplate.diagnosis.result import Diagnosis, Gap, Location
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.target import FrfTarget
from torchplate.plate import Mesh

SILENT = {"say": lambda _: None}


class TestGrid:
    def test_a_plate_has_as_many_nodes_as_a_square_one_and_equal_spacings(self):
        square, strip = (Grid.of(mesh, SETTINGS.inferring) for mesh in (Mesh(0.4, 0.4, 4, 4), Mesh(0.8, 0.2, 4, 4)))
        assert (square.n_x, square.n_y, square.square) == (7, 7, True)
        assert (strip.n_x, strip.n_y, strip.square) == (13, 4, False)
        assert float(strip.area.sum()) == pytest.approx(1.0)

    def test_the_centre_is_where_the_weight_sits(self):
        grid = Grid(5, 4, False)
        values = torch.zeros(20, dtype=torch.float64)
        values[1 * 5 + 2], values[1 * 5 + 3] = -0.4, -0.4
        middle, spread = grid.centre(values)
        assert middle.tolist() == pytest.approx([0.625, 1 / 3])
        assert spread.tolist() == pytest.approx([0.125, 0.0], abs=1e-12)

    def test_a_value_that_no_frf_sees_has_no_weight(self):
        """The free edge of a plate does not bend: how stiff it is there is anybody's guess."""
        grid = Grid(3, 2, False)
        values = torch.tensor([5.0, 0.1, 0.0, 5.0, 0.1, 0.0], dtype=torch.float64)
        seen = torch.tensor([0.0, 1.0, 1.0, 0.0, 1.0, 1.0], dtype=torch.float64)
        assert grid.centre(values)[0].tolist() == pytest.approx([0.0, 0.5], abs=1e-3)
        assert grid.centre(values, seen)[0].tolist() == pytest.approx([0.5, 0.5])

    def test_a_turned_square_bends_along_y_where_it_bent_along_x(self):
        grid = Grid(3, 3, True)
        values = torch.zeros(3, 9, dtype=torch.float64)
        values[0, 2], values[2, 1] = 1.0, 2.0
        turned = grid.images(values.flatten())[3].unflatten(0, (3, 9))
        assert turned.nonzero().tolist() == [[1, 6], [2, 3]]
        # Without directions the values stay what they are.
        assert Grid(3, 3, True).images(values[0])[3].nonzero().tolist() == [[6]]

    def test_a_square_has_seven_images_and_a_rectangle_three(self):
        values = torch.arange(12.0, dtype=torch.float64)
        images = Grid(4, 3, False).images(values)
        assert len(images) == 3
        assert images[0][:4].tolist() == [3.0, 2.0, 1.0, 0.0]
        assert images[1][:4].tolist() == [8.0, 9.0, 10.0, 11.0]
        square = Grid(3, 3, True).images(values[:9])
        assert len({tuple(one.tolist()) for one in square}) == 7


def products(jacobian: torch.Tensor, residual: torch.Tensor, n_fold: int = 5) -> Products:
    rows = [torch.arange(len(residual)) % n_fold == fold for fold in range(n_fold)]
    parts = [(jacobian[row], residual[row]) for row in rows]
    n = jacobian.shape[1]
    nothing = torch.zeros(n, n, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)
    return Products(
        torch.stack([j.mT @ j for j, _ in parts]), torch.stack([j.mT @ r for j, r in parts]),
        torch.stack([r.square().sum() for _, r in parts]), nothing, len(residual), n,
    )  # fmt: skip


class TestStrength:
    def _data(self, values: torch.Tensor, n: int = 90) -> Products:
        generator = torch.Generator().manual_seed(5)
        jacobian = torch.randn(n, len(values), generator=generator, dtype=torch.float64)
        noise = torch.randn(n, generator=generator, dtype=torch.float64)
        return products(jacobian, -jacobian @ values + noise)

    def test_what_is_predicted_is_better_than_nothing_where_there_is_something(self):
        values = torch.zeros(30, dtype=torch.float64)
        values[13] = 3.0
        grid = Grid(6, 5, False)
        data = self._data(values)
        none = torch.zeros_like(values)
        chosen = cross_validated(data, forms(grid, none, SETTINGS.inferring), SETTINGS.inferring)
        assert chosen.error < 0.5 * float(data.square.sum()) / data.n
        again = cross_validated(self._data(values), forms(grid, values, SETTINGS.inferring), SETTINGS.inferring)
        # Weights that know where the one value is leave nothing but noise.
        assert again.form == "sparse"
        assert again.error < 0.8 * chosen.error

    def test_noise_is_not_predicted_by_a_field(self):
        grid = Grid(6, 5, False)
        nothing = torch.zeros(30, dtype=torch.float64)
        data = self._data(nothing)
        chosen = cross_validated(data, forms(grid, nothing, SETTINGS.inferring), SETTINGS.inferring)
        assert chosen.error > (1 - SETTINGS.inferring.helps) * float(data.square.sum()) / data.n

    def test_directions_of_which_rounding_alone_is_left_stay_where_they_are(self):
        """A fold that alone saw them left zeros on the diagonal and rounding beside: the diagnosis ended in that."""
        generator = torch.Generator().manual_seed(4)
        seen = torch.randn(9, 4, generator=generator, dtype=torch.float64)
        rounding = 1e29 * torch.randn(5, 5, generator=generator, dtype=torch.float64)
        matrix = torch.zeros(2, 9, 9, dtype=torch.float64)
        matrix[:, 5:, 5:] = seen.mT @ seen
        matrix[0, :5, :5] = (rounding + rounding.mT).fill_diagonal_(0.0)
        matrix[1, :5, :5] = 1e46 * torch.eye(5, dtype=torch.float64)
        right = torch.randn(2, 9, generator=generator, dtype=torch.float64)
        x = _solved(matrix, right)
        assert x[0, :5].tolist() == [0.0] * 5
        expected = -torch.linalg.solve(seen.mT @ seen, right[:, 5:].mT).mT
        assert torch.allclose(x[:, 5:], expected, rtol=1e-6)

    def test_values_that_must_not_be_negative_are_not(self):
        generator = torch.Generator().manual_seed(2)
        jacobian = torch.randn(40, 6, generator=generator, dtype=torch.float64)
        true = torch.tensor([2.0, -1.0, 0.5, -3.0, 0.0, 1.0], dtype=torch.float64)
        x, _ = solved(jacobian.mT @ jacobian, -jacobian.mT @ jacobian @ true, SETTINGS.inferring, 5)
        assert bool((x[1:] > -1e-6).all())
        # The first may be anything.
        other, _ = solved(jacobian.mT @ jacobian, jacobian.mT @ jacobian @ true, SETTINGS.inferring, 5)
        assert float(other[0]) < -1


@pytest.fixture(scope="module")
def scene(lab):
    """A plate with a mass in it that the fit knows nothing of."""
    return lab.Scene(hidden={"mass": 0.25})


@pytest.mark.parametrize("kind", ["stiffness", "mass", "loss", "support"])
@pytest.mark.check
def test_the_columns_are_the_derivatives_of_the_frfs(lab, kind):
    with torch.no_grad():
        scene = lab.Scene()
        grid = Grid(3, 4, False)
        model = FieldModel(scene.builder, scene.fit, kind, grid)
        n = len(model.effect.parameters)
        assert n == (36 if kind == "stiffness" else 12)
        values = 0.1 * model.unit * torch.linspace(0.5, 1.5, n, dtype=torch.float64)
        model.rebased(scene.fit.theta, values)
        lines = lab.SMALL_LINES
        every = model.joined(scene.fit.theta, values)
        columns = model.columns(model.reduced, every, lines)
        for k in (0, 5, 10, *((17, 30) if kind == "stiffness" else ())):
            step = torch.zeros_like(values)
            step[k] = 1e-4 * model.unit
            high, low = (
                model.reduced.frf(model.joined(scene.fit.theta, values + sign * step), lines) for sign in (1, -1)
            )
            slope = (high - low) / (2 * step[k])
            # Losses couple the modes, which the columns do not know.
            assert float((columns[k] - slope).norm() / slope.norm()) < 2e-2


@torch.no_grad()
def test_a_single_value_that_falls_to_none_goes_on_as_a_smooth_field(scene, monkeypatch):
    """A support or a loss that would be negative is none."""
    model = FieldModel(scene.builder, scene.fit, "support", Grid(3, 4, False))
    descent = FieldDescent(model, {})
    position = scene.fit.model.space.to_cube(scene.fit.theta)
    values = torch.zeros(12, dtype=torch.float64)
    values[5] = model.unit
    shapes = []

    def fallen(problem, place, linear, shape, level):
        shapes.append(shape)
        return place._replace(values=torch.zeros_like(values))

    monkeypatch.setattr(descent, "_stepped", fallen)
    descent.widely(Place(position, values, None))
    # Weights of a sparse field stand on the diagonal alone.
    alone = [not bool((shape - torch.diag(shape.diagonal())).any()) for shape in shapes]
    assert alone[0]
    assert not any(alone[1:])
    assert len(alone) > 1


@pytest.fixture(scope="module")
def inferred(scene):
    return infer_field(scene.builder, scene.fit, {}, **SILENT)


@pytest.mark.check
def test_a_mass_is_found_as_a_mass_at_its_place(lab, scene, inferred):
    assert inferred is not None
    found = inferred.found
    assert found.kind == "mass"
    # The scene has four elements a side, all of one value each.
    assert max(abs(a - b) for a, b in zip(found.place, lab.spot, strict=True)) < 0.15
    assert found.unit == "kg"
    assert found.total == pytest.approx(0.25, rel=0.3)
    assert found.gap_after < 0.5 * found.gap_before


@pytest.mark.check
def test_a_plate_that_is_stiffer_in_one_direction_is_found_as_that(lab):
    """As a curved one is. By one number for all directions a field of mass came nearer."""
    scene = lab.Scene(hidden={"ratio": 1.5})
    found = infer_field(scene.builder, scene.fit, {}, **SILENT).found
    assert found.kind == "stiffness"
    assert found.directions == ("along x", "along y", "in twist")
    along_x, along_y, _ = torch.tensor(found.values).unflatten(0, (3, -1)).mean(-1).tolist()
    assert along_y - along_x > 0.2
    assert found.gap_after < 0.3 * found.gap_before


@pytest.mark.check
def test_a_field_that_leaves_the_gap_is_said_to_and_not_shown(scene, monkeypatch):
    """The log said that a field takes half of the misfit, and the report that none takes more than a little."""
    monkeypatch.setattr(FrfTarget, "gap", lambda *_: torch.tensor(0.4))
    inferred = infer_field(scene.builder, scene.fit, {}, **SILENT)
    given = Diagnosis(
        "unexplained", (), Gap(0.4, 0.4, None, None, 0.01), Location((), (), {}, None), (), (), ("left",), (), (), {},
        scene.builder.given, None,
    )  # fmt: skip
    monkeypatch.setattr("torchplate.diagnosis.field.infer.infer_field", lambda *_: inferred)
    found = with_field(given, scene.builder, scene.fit, {}, **SILENT)
    assert found.field is None
    assert "A field of mass would take" in found.missing[1]
    assert "leaves the gap at 40 % where it is 40 %" in found.missing[1]


@pytest.mark.check
def test_a_gap_that_says_nothing_does_not_hide_a_field(scene, monkeypatch):
    """Peaks that come nearer by less than their width leave a gap of 90 % where it is."""
    monkeypatch.setattr(FrfTarget, "gap", lambda *_: torch.tensor(0.9))
    inferred = infer_field(scene.builder, scene.fit, {}, **SILENT)
    assert inferred.found.kind == "mass"
    assert "off what was left of FRFs put aside, smoothed and sharp" in inferred.found.sentences[0]
    # Of six one is put aside.
    assert "Its kind was chosen by 1 FRF put aside: take it as a guess" in inferred.found.sentences[-1]


def test_a_fifth_is_put_aside_where_there_are_enough(scene):
    target = scene.builder.target
    seen, apart = put_aside(target)
    assert int(apart.sum()) == 1
    assert torch.equal(seen.fitted | apart, target.fitted)
    assert not bool((seen.fitted & apart).any())
    two = target.fitted.clone()
    two[0, :2] = False
    few = target.holding_out(two)
    same, all_of_them = put_aside(few)
    assert same is few
    assert torch.equal(all_of_them, few.fitted)


@torch.no_grad()
def test_what_brings_all_peaks_nearer_is_nearer(lab):
    """Sharply half of what is missing leaves as much as none of it: peaks are 2.5 widths off instead of five."""
    scene = lab.Scene(hidden={"gain": 1.0 + 1e-12}, young=1.85e11)
    grid = Grid.of(scene.fit.model.mesh, SETTINGS.inferring)
    descent = FieldDescent(FieldModel(scene.builder, scene.fit, "stiffness", grid), {})
    none, target = descent.start(scene.fit), scene.builder.target
    half = none._replace(values=torch.full_like(none.values, 0.5 * (2.05 / 1.85 - 1)))
    assert part_left(target, descent.left(half)) > 0.9 * part_left(target, descent.left(none))
    aside = Aside(target, part_left(target, descent.left(none)))
    assert aside.log_left(descent, half) < aside.log_left(descent, none) - 0.3


@pytest.mark.check
def test_the_model_with_the_field_is_what_was_told_of_it(scene, inferred):
    model = inferred.model
    assert not model.names
    target = scene.builder.target
    with torch.no_grad():
        read = model.frf(model.known[:0], target.frequency)
    # The basis of the inference against all dofs of the model.
    assert float(target.gap(read)) == pytest.approx(inferred.found.gap_after, rel=0.05, abs=2e-3)
    field = next(effect for effect in model.effects.values() if effect.name == "field")
    assert field.values == pytest.approx(inferred.found.values, rel=1e-4, abs=1e-9)


@pytest.mark.check
def test_what_a_field_takes_is_said_of_all_lines(scene):
    """Of every second line it was found; what was measured has all of them."""
    whole = scene.builder.target
    builder = scene.builder.against(every_nth(whole, 2))
    fit = judged_at(builder, scene.fit, {}, scene.fit.model.space.to_cube(scene.fit.theta))
    found = infer_field(builder, fit, {}, **SILENT)
    assert found is not None
    with torch.no_grad():
        before, after = (
            float(whole.gap(model.frf(theta, whole.frequency)))
            for model, theta in ((fit.model, fit.theta), (found.model, found.model.known[:0]))
        )
    assert found.found.gap_before == pytest.approx(before, rel=1e-4)
    assert found.found.gap_after == pytest.approx(after, rel=0.05, abs=2e-3)


@pytest.mark.check
def test_where_noise_alone_is_left_there_is_no_field(lab):
    scene = lab.Scene(hidden={"gain": 1.0 + 1e-12})
    assert infer_field(scene.builder, scene.fit, {}, **SILENT) is None


@pytest.mark.check
def test_a_field_is_no_name_and_changes_no_verdict(lab, scene, inferred, monkeypatch):
    given = Diagnosis(
        "unexplained", (), Gap(0.4, 0.4, None, None, 0.01), Location((), (), {}, None), (), (), ("left",), (), (), {},
        scene.builder.given, None,
    )  # fmt: skip
    monkeypatch.setattr("torchplate.diagnosis.field.infer.infer_field", lambda *_: inferred)
    found = with_field(given, scene.builder, scene.fit, {}, **SILENT)
    assert (found.verdict, found.effects, found.gap, found.missing) == ("unexplained", (), given.gap, ("left",))
    told = found.to_dict()["field"]
    assert told["kind"] == "mass"
    assert set(told["place"]) == {"x", "y"}
    assert sum(told["probability"].values()) == pytest.approx(1.0, abs=1e-3)
    assert "This is no name." in told["sentences"][0]
    monkeypatch.setattr("torchplate.diagnosis.field.infer.infer_field", lambda *_: None)
    without = with_field(given, scene.builder, scene.fit, {}, **SILENT)
    assert without.field is None
    assert replace(without, missing=("left",)).to_dict() | {"seconds": 0} == given.to_dict() | {"seconds": 0} | {
        "n_evaluation": scene.builder.n_evaluation
    }
    assert "No field" in without.missing[1]
