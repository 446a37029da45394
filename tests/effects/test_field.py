"""A field without a name: what its values mean, of each kind."""

import pytest
import torch

from torchplate.cli.config.build import load_model
from torchplate.effects import Field, GroundSpring, HystereticDamping, Orthotropy, Plate
from torchplate.model import PlateModel
from torchplate.plate import Mesh

NONE = torch.zeros(0, dtype=torch.float64)
LINES = torch.linspace(20.0, 400.0, 40, dtype=torch.float64)
METAL = {
    "plate.youngs_modulus": 69e9, "plate.poisson_ratio": 0.31, "plate.density": 2710.0, "plate.thickness": 0.0031,
    "loss.stiffness_loss_factor": 0.004,
}  # fmt: skip
SIDES = 0.52, 0.37


def read(known=None, **more) -> torch.Tensor:
    effects = {"plate": Plate(), "loss": HystereticDamping(), **more}
    model = PlateModel(Mesh(*SIDES, 5, 4), effects, METAL | (known or {}), {}, [3, (0.6, 0.7)], [8], "accelerance")
    return model.frf(NONE, LINES)


def close(one: torch.Tensor, other: torch.Tensor) -> bool:
    return float((one - other).norm() / other.norm()) < 1e-9  # rounding of two eigenproblems


@pytest.mark.parametrize(
    ("kind", "value", "known"),
    [
        ("stiffness", -0.2, {"plate.youngs_modulus": 0.8 * 69e9}),
        ("mass", 0.3, {"plate.density": 1.3 * 2710.0}),
        ("loss", 0.02, {"loss.stiffness_loss_factor": 0.024}),
    ],
)
def test_a_field_of_one_value_is_the_plates_own_number_everywhere(kind, value, known):
    assert close(read(missing=Field(kind, 3, 4, (value,) * 12)), read(known))


def test_a_directional_field_of_one_value_each_is_an_orthotropic_plate():
    """D₁₁, D₂₂, D₁₂ and D₃₃ of that plate, by hand."""
    along_x, along_y, twist = 0.44, -0.19, 0.3
    field = Field("stiffness", 3, 4, (*(along_x,) * 12, *(along_y,) * 12, *(twist,) * 12), directional=True)
    root = ((1 + along_x) * (1 + along_y)) ** 0.5
    own = {
        "plate.youngs_modulus": 69e9 * root,
        "grain.young_ratio": (1 + along_y) / (1 + along_x),
        "grain.shear_factor": (1 + twist) / root,
    }
    assert close(read(missing=field), read(own, grain=Orthotropy()))


def test_a_directional_field_whose_three_are_alike_is_one_without_directions():
    values = tuple(torch.linspace(-0.3, 0.6, 12, dtype=torch.float64).tolist())
    directional = Field("stiffness", 3, 4, values * 3, directional=True)
    assert close(read(missing=directional), read(missing=Field("stiffness", 3, 4, values)))


def test_only_a_stiffness_has_directions():
    with pytest.raises(ValueError, match=r"Expected field.directional of a stiffness alone, got a field of 'mass'"):
        Field("mass", 2, 2, directional=True)
    with pytest.raises(ValueError, match=r"Expected 12 field.values.*along x, along y and in twist, got 4"):
        Field("stiffness", 2, 2, (0.1,) * 4, directional=True)


def test_losses_of_two_fields_add_up_place_by_place():
    """A loss that grows along x and one that falls along y: as one field whose values are their sums."""
    along, across = [0.004, 0.03, 0.008, 0.05], [0.02, 0.02, 0.001, 0.006]
    both = tuple(one + other for one, other in zip(along, across, strict=True))
    two = read(one=Field("loss", 2, 2, tuple(along)), other=Field("loss", 2, 2, tuple(across)))
    assert close(two, read(missing=Field("loss", 2, 2, both)))
    # The part that is small beside the other is seen: so much the two differ.
    assert not close(two, read(missing=Field("loss", 2, 2, tuple(along))))


def test_a_field_of_support_is_a_spring_at_each_node_of_its_grid():
    values = torch.linspace(100.0, 2400.0, 6).tolist()
    field = Field("support", 3, 2, tuple(values))
    springs = {f"s{k}": GroundSpring() for k in range(6)}
    known = {}
    for k, (x, y) in enumerate([(0, 0), (0.5, 0), (1, 0), (0, 1), (0.5, 1), (1, 1)]):
        known |= {f"s{k}.x": float(x), f"s{k}.y": float(y), f"s{k}.stiffness": values[k]}
    assert close(read(missing=field), read(known, **springs))


def test_hats_are_one_at_their_node_and_one_in_all():
    field = Field("mass", 4, 3)
    torch.testing.assert_close(field.hats(field.nodes_at), torch.eye(12, dtype=torch.float64))
    places = torch.rand(30, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    torch.testing.assert_close(field.hats(places).sum(-1), torch.ones(30, dtype=torch.float64))
    # x counts first: a quarter of the way from the node at (1/3, 0) to that at (1/3, 1/2).
    assert field.hats(torch.tensor([[1 / 3, 0.125]], dtype=torch.float64))[0, [1, 5]].tolist() == pytest.approx(
        [0.75, 0.25]
    )


def test_a_key_goes_before_the_list_and_the_list_before_zero():
    listed = Field("mass", 2, 2, (0.1, 0.2, 0.3, 0.4))
    assert close(
        read({"missing.value_2": 0.5}, missing=listed), read(missing=Field("mass", 2, 2, (0.1, 0.5, 0.3, 0.4)))
    )
    assert close(read(missing=Field("mass", 2, 2)), read())


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"kind": "colour"}, "one of stiffness, mass, loss, support"),
        ({"n_x": 1}, "two nodes a side"),
        ({"n_x": 1000, "n_y": 101}, "100000 nodes at most"),
        ({"n_x": 2, "n_y": 3, "values": (0.1,) * 5}, "Expected 6 field.values"),
    ],
)
def test_what_makes_no_field_is_refused(options, told):
    with pytest.raises(ValueError, match=told):
        Field(**options)


def test_a_plate_of_no_stiffness_is_refused():
    with pytest.raises(ValueError, match="value_3"):
        read(missing=Field("stiffness", 2, 2, (0.0, 0.0, -1.2, 0.0)))


@pytest.mark.parametrize(
    ("body", "searched", "same"),
    [
        ("kind: mass, n_x: 2, n_y: 2, values: [0.1, 0.2, 0.3, 0.4], value_4: [0.0, 1.0]", "value_4",
         Field("mass", 2, 2, (0.1, 0.2, 0.3, 0.6))),
        ("kind: stiffness, directional: true, value_9: [0.0, 1.0]", "value_9",
         Field("stiffness", 2, 2, (*(0.0,) * 8, 0.6, *(0.0,) * 3), True)),
    ],
    ids=["mass", "directional"],
)  # fmt: skip
def test_a_config_holds_a_field_as_a_list(tmp_path, body, searched, same):
    config = tmp_path / "plate.yaml"
    config.write_text(
        "mesh: {length_x: 0.52, length_y: 0.37, n_x: 5, n_y: 4}\n"
        "effects:\n"
        "  plate: {effect: plate, youngs_modulus: 69e9, poisson_ratio: 0.31, density: 2710.0, thickness: 0.0031}\n"
        "  loss: {effect: hysteretic_damping, stiffness_loss_factor: 0.004}\n"
        f"  missing: {{effect: field, {body}}}\n"
        "measurement: {response: [3, [0.6, 0.7]], reference: [8], kind: accelerance}\n"
    )
    model = load_model(config)
    assert model.names == (f"missing.{searched}",)
    theta = torch.tensor([0.6], dtype=torch.float64)
    assert close(model.frf(theta, LINES), read(missing=same))
    # A value at a corner, in twist, does something.
    assert not close(model.frf(0 * theta, LINES), model.frf(theta, LINES))


def test_a_search_for_what_is_missing_never_names_it():
    section = PlateModel(Mesh(*SIDES, 4, 3), {"plate": Plate(), "loss": HystereticDamping()}, METAL).plan(NONE).section
    assert not Field.may_be_missing(section)


def test_without_a_grid_it_has_a_node_at_each_corner_of_the_plate():
    field = Field("mass")
    assert field.nodes_at.tolist() == [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    assert list(field.parameters) == ["value_1", "value_2", "value_3", "value_4"]
    assert all(one.neutral == 0.0 for one in field.parameters.values())
