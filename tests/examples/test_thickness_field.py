"""A thickness field comes out of FRFs, by gradients that are right."""

from pathlib import Path

import pytest
import torch

from torchplate.effects import CATALOGUE
from torchplate.examples.thickness_field import FORCES, SENSORS, Found, draw, main, plate, roughness, true_field
from torchplate.plate import Mesh


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Found, Path]:
    out = tmp_path_factory.mktemp("examples") / "deeper" / "field.png"
    result = main(n_x=6, n_y=5, bands=(90.0, 180.0), n_iteration=40, out=out, say=lambda _: None)
    return result, out


@pytest.mark.check
def test_the_field_is_found_far_better_than_any_uniform_plate(found: tuple[Found, Path]) -> None:
    result = found[0]
    # A tenth was found in this short form; a fourth leaves room for other processors.
    assert result.error < 0.25 * result.best_uniform_error
    assert result.best_uniform_error < result.start_error


@pytest.mark.check
def test_an_frf_that_no_fit_has_seen_is_foretold(found: tuple[Found, Path]) -> None:
    result = found[0]
    # The noise of the fitted FRFs is 1 % of them; the start misses the peaks, which is nearly all of the norm.
    assert result.held_out < 0.03
    assert result.start_held_out > 0.5


def test_the_gradient_in_all_elements_costs_a_few_frfs(found: tuple[Found, Path]) -> None:
    result = found[0]
    # Differences would take 31 FRFs; 2 to 4 were seen, more only on a machine that is busy.
    assert 0 < result.gradient_time < 15 * result.frf_time


def test_the_figure_is_written_and_small(found: tuple[Found, Path]) -> None:
    assert 5_000 < found[1].stat().st_size < 100_000


def test_the_figure_shows_truth_and_find_on_one_scale() -> None:
    truth, thickness = torch.rand(2, 5, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 3e-3
    images = [axis.images[0] for axis in draw(truth, thickness, (0.5, 0.4)).axes if axis.images]
    assert [image.get_array().shape for image in images] == [(5, 6)] * 3
    assert images[0].get_clim() == images[1].get_clim()
    error = torch.from_numpy(images[2].get_array().data)
    torch.testing.assert_close(error, 100 * (thickness - truth) / truth)


def test_a_field_of_one_value_is_the_same_plate_of_another_thickness() -> None:
    frequency = torch.tensor([23.0, 71.0, 140.0], dtype=torch.float64)
    model, thicker = plate(5, 4), plate(5, 4)
    # The order of the known values is that of the effects: h is the plate's fourth.
    thicker.known[3] = 3e-3 * 1.07
    field = torch.full((20,), 1.07, dtype=torch.float64).log()
    # Rounding of the eigensolver.
    torch.testing.assert_close(model.frf(field, frequency), thicker.frf(0 * field, frequency), rtol=1e-8, atol=1e-10)


def test_each_value_sits_at_its_own_element() -> None:
    model = plate(5, 4)
    field = torch.zeros(20, dtype=torch.float64)
    field[7] = 0.3
    thickness = model.plan(field).section.thickness
    # Elements count along x first: number 7 is the third of the second row.
    place = model.mesh.element_place[thickness.argmax()]
    torch.testing.assert_close(place, torch.tensor([2.5 / 5, 1.5 / 4], dtype=torch.float64))
    torch.testing.assert_close(thickness.max() / thickness.min(), field.max().exp())


def test_the_gradient_is_that_of_a_direct_solve() -> None:
    model = plate(5, 4)
    frequency = torch.tensor([23.0, 71.0, 140.0], dtype=torch.float64)
    field = true_field(model.mesh)
    slopes = []
    for frf in (model.frf, model.frf_direct):
        wanted = field.clone().requires_grad_()
        frf(wanted, frequency).abs().log().sum().backward()
        slopes.append(wanted.grad)
    # What the library's own gradients are held to.
    assert float((slopes[0] - slopes[1]).abs().max()) < 1e-6 * float(slopes[1].abs().max())


def test_roughness_is_the_sum_over_neighbours() -> None:
    mesh = Mesh(0.5, 0.4, 3, 2)
    field = torch.tensor([1.0, 2.0, 4.0, 0.0, 2.0, 7.0], dtype=torch.float64)
    # Along x: 1 + 4 + 4 + 25; along y: 1 + 0 + 9.
    assert float(roughness(field, mesh)) == 44.0


def test_no_place_is_on_a_line_of_symmetry_and_the_catalogue_is_as_it_was() -> None:
    assert all(abs(value - 0.5) > 0.05 for point in [*SENSORS, *FORCES] for value in point)
    assert {name for name in CATALOGUE if "field" in name} == {"thickness_field", "field"}
