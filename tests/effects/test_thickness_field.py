"""A thickness in long waves: what each term means."""

import itertools
import math

import pytest
import torch

from torchplate.effects import Plate, ThicknessField
from torchplate.effects.thickness_field import AMPLITUDE
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
METAL = {
    "plate.youngs_modulus": 69e9, "plate.poisson_ratio": 0.31, "plate.density": 2710.0, "plate.thickness": 0.0031,
}  # fmt: skip
TERMS = list(ThicknessField.parameters)
EVERY_SIGN = list(itertools.product((-1, 1), repeat=len(TERMS)))


def build(known: dict[str, float], mesh: Mesh) -> PlateModel:
    return PlateModel(
        mesh, {"plate": Plate(), "field": ThicknessField()}, METAL | {f"field.{k}": v for k, v in known.items()}
    )


@pytest.mark.parametrize("name", TERMS)
def test_a_term_has_zero_mean_and_its_amplitude_is_its_root_mean_square(name: str) -> None:
    thickness = build({name: 0.013}, Mesh(0.5, 0.3, 12, 9)).plan(NONE).section.thickness
    off = thickness / 0.0031 - 1
    # A sum of cosines at the middles of equal parts vanishes as the integral does.
    assert float(off.mean().abs()) < 1e-12
    assert float(off.square().mean().sqrt()) == pytest.approx(0.013, rel=1e-9)


def test_no_plate_of_those_that_are_looked_at_has_a_place_without_thickness() -> None:
    mesh = Mesh(0.5, 0.3, 12, 9)
    ends = [{name: sign * AMPLITUDE.high for name, sign in zip(TERMS, signs, strict=True)} for signs in EVERY_SIGN]
    assert AMPLITUDE.low == -AMPLITUDE.high
    assert min(float(build(one, mesh).plan(NONE).section.thickness.min()) for one in ends) > 0


def test_terms_do_not_overlap() -> None:
    mesh = Mesh(0.5, 0.3, 12, 9)
    fields = torch.stack([build({name: 0.01}, mesh).plan(NONE).section.thickness / 0.0031 - 1 for name in TERMS])
    product = fields @ fields.mT / mesh.n_element / 1e-4
    torch.testing.assert_close(product, torch.eye(len(TERMS)).double(), rtol=0, atol=1e-9)


def test_small_terms_move_a_mode_by_its_energies_there() -> None:
    mesh, step = Mesh(0.5, 0.3, 8, 6), 1e-5
    bare = build({}, mesh)
    modes = bare.modes(NONE)
    moved = build({"a10": 0.5 * step, "a02": -step}, mesh)
    system, change = bare.system(NONE), moved.system(NONE)
    shape = modes.shape[:, 3:9]
    gained = ((change.stiffness - system.stiffness) @ shape * shape).sum(0)
    gained = gained - modes.eigenvalue[3:9] * ((change.mass - system.mass) @ shape * shape).sum(0)
    found = moved.natural_frequencies(NONE, 9)[3:].square() * (2 * math.pi) ** 2 - modes.eigenvalue[3:9]
    torch.testing.assert_close(found, gained, rtol=2e-2, atol=1e-9 * float(modes.eigenvalue[8]))


def test_no_sum_of_allowed_terms_makes_a_plate_of_no_thickness() -> None:
    for sign in torch.cartesian_prod(*[torch.tensor([-0.11, 0.11])] * len(TERMS)).tolist():
        thickness = build(dict(zip(TERMS, sign, strict=True)), Mesh(0.5, 0.3, 10, 8)).plan(NONE).section.thickness
        assert float(thickness.min()) > 0


def test_a_search_for_what_is_missing_leaves_it_to_the_nuisance() -> None:
    section = build({}, Mesh(0.5, 0.3, 4, 3)).plan(NONE).section
    assert not ThicknessField.may_be_missing(section)
    assert Plate.may_be_missing(section)
