"""MAC and COMAC by hand, and measured modes against a model's: paired by shape, weighed by their scatter."""

import pytest
import torch

from torchplate.discrepancy import Evidence, ModalEvidence, Objective, comac, mac
from torchplate.effects import Plate, PointMass
from torchplate.identification import identify
from torchplate.measurement import Channel, ModalModel, NaturalFrequencies
from torchplate.model import PlateModel, Searched, modes_at
from torchplate.plate import Mesh
from torchplate.search import LeastSquares

TRUTH = {"plate.youngs_modulus": 2.04e11, "lump.x": 0.3, "lump.mass": 0.05}
BOX = {"plate.youngs_modulus": (1.5e11, 2.6e11), "lump.x": (0.0, 1.0), "lump.mass": (0.0, 0.2)}
KNOWN = {"plate.poisson_ratio": 0.3, "plate.density": 7860.0, "plate.thickness": 0.003, "lump.y": 0.4}
NODES = [1, 3, 5, 11, 13, 15, 17, 19, 21, 23, 25, 29, 31, 33, 35]


def plate(*searched: str) -> PlateModel:
    effects = {"plate": Plate(), "lump": PointMass()}
    known = KNOWN | {name: value for name, value in TRUTH.items() if name not in searched}
    return PlateModel(Mesh(0.41, 0.29, 6, 4), effects, known, {name: Searched(*BOX[name]) for name in searched})


def measured(order: tuple[int, ...] = (3, 4, 5, 6, 7, 8), noise: float = 0.0) -> ModalModel:
    """Modes of the true plate in any order, each shape on a scale and with a sign of its own."""
    model = plate()
    true = modes_at(model, model.known.new_zeros(0), model.mesh.places(NODES), 12)
    shape = true.shape[list(order)]
    random = torch.randn(shape.shape, dtype=shape.dtype, generator=torch.Generator().manual_seed(1))
    shape = shape + noise * shape.square().mean(-1, keepdim=True).sqrt() * random
    shape = shape * torch.tensor([(-1.0) ** i * (i + 1) for i in range(len(order))], dtype=shape.dtype)[:, None]
    unknown = torch.full((len(order),), torch.nan, dtype=shape.dtype)
    return ModalModel(true.frequency[list(order)], unknown, shape, tuple(Channel(node) for node in NODES))


def test_the_mac_is_that_of_hand_numbers():
    one = torch.tensor([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    other = torch.tensor([[2.0, 1.0, 2.0], [-2.0, -4.0, 0.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    # (1·2 + 2·1)² / (5 · 9), 4 / 9 of the second; a multiple; a shape of zeros.
    expected = torch.tensor([[16 / 45, 1.0, 0.0], [4 / 9, 0.0, 0.0]], dtype=torch.float64)
    torch.testing.assert_close(mac(one, other), expected)
    turned = one * torch.exp(torch.tensor([0.3j, 2.1j], dtype=torch.complex128))[:, None]
    torch.testing.assert_close(mac(turned, other), expected)
    torch.testing.assert_close(mac(one.expand(4, 2, 3), other), expected.expand(4, 2, 3))


def test_the_mac_of_complex_shapes_conjugates_one_of_them():
    shape = torch.tensor([[1.0, 1.0j]], dtype=torch.complex128)
    assert float(mac(shape, shape)) == pytest.approx(1.0)
    assert float(mac(shape, shape.conj())) == pytest.approx(0.0)


def test_the_comac_is_that_of_hand_numbers():
    one = torch.tensor([[3.0, 4.0], [4.0, 3.0]], dtype=torch.float64)
    other = torch.tensor([[-6.0, 8.0], [0.0, 2.0]], dtype=torch.float64)
    # Unit norms: (.6, .8), (.8, .6) beside (.6, .8), (0, 1).
    first = (0.6 * 0.6) ** 2 / ((0.36 + 0.64) * 0.36)
    second = (0.8 * 0.8 + 0.6) ** 2 / ((0.64 + 0.36) * (0.64 + 1.0))
    torch.testing.assert_close(comac(one, other), torch.tensor([first, second], dtype=torch.float64))


def test_what_is_left_of_a_shape_is_one_less_its_mac():
    modal, model = measured(noise=0.2), plate()
    theta = model.known.new_zeros(0)
    evidence = ModalEvidence.of(model, modal, frequency_std=0.002, shape_std=0.05)
    residual = evidence.residual(model, theta)
    n_mode, n_point = modal.shape.shape
    assert float(residual[:n_mode].abs().max()) < 1e-12
    left = residual[n_mode:].reshape(n_mode, n_point).square().sum(-1)
    alike = mac(modal.shape, evidence.paired(model, theta).shape).diagonal()
    torch.testing.assert_close(left, 0.04**2 * (1 - alike))
    turned = ModalModel(modal.frequency, modal.damping_ratio, modal.shape * 1j, modal.point)
    again = ModalEvidence.of(model, turned, frequency_std=0.002, shape_std=0.05).error(model, theta)
    torch.testing.assert_close(again, evidence.error(model, theta))


def test_modes_are_paired_by_shape_in_whatever_order_they_come():
    order = (6, 3, 8, 4, 10, 5)
    modal, model = measured(order, noise=0.02), plate("plate.youngs_modulus")
    evidence = ModalEvidence.of(model, modal)
    theta = torch.tensor([[1.6e11], [2.04e11], [2.5e11]], dtype=torch.float64)
    assert evidence.paired(model, theta).mode.tolist() == [list(order)] * 3
    table = evidence.table(model)
    assert table.mode.tolist() == [mode + 1 for mode in sorted(order)]
    assert table.frequency.tolist() == sorted(modal.frequency.tolist())


def test_shapes_that_have_changed_places_are_paired_with_the_other_mode():
    modal, model = measured((3, 4)), plate()
    swapped = ModalModel(modal.frequency, modal.damping_ratio, modal.shape.flip(0), modal.point)
    pairs = ModalEvidence.of(model, swapped).pairs(model, model.known.new_zeros(0))
    assert [pair.mode for pair in pairs] == [5, 4]
    assert min(pair.mac for pair in pairs) > 0.999
    said: list[str] = []
    # A table rises with the number of the mode.
    assert ModalEvidence.of(model, swapped).table(model, said.append).mode.tolist() == [4, 5]
    assert "changed places" in said[0]


def test_where_shapes_tell_nothing_the_nearest_frequencies_are_paired():
    modal, model = measured((8, 4, 7, 3)), plate("plate.youngs_modulus")
    single = ModalModel(modal.frequency, modal.damping_ratio, modal.shape[:, :1], modal.point[:1])
    paired = ModalEvidence.of(model, single).paired(model, torch.tensor([2.06e11], dtype=torch.float64))
    assert paired.mode.tolist() == [8, 4, 7, 3]


def test_of_a_cluster_that_was_measured_in_part_nobody_knows_the_number():
    model, said = plate(), []
    # Modes 6 and 7 lie within 0.6 %.
    assert ModalEvidence.of(model, measured()).table(model).mode.tolist() == [4, 5, 6, 7, 8, 9]
    in_part = ModalEvidence.of(model, measured((3, 4, 6, 7, 8)))
    assert in_part.table(model, said.append).mode.tolist() == [4, 5, 8, 9]
    assert "left out 194.13 Hz" in said[0]
    alone = ModalEvidence.of(model, measured((6,)))
    assert alone.table(model).mode.tolist() == [7]


# torch compiles rules of its own by a function that it has itself deprecated.
@pytest.mark.filterwarnings("ignore:`torch.jit.script`:DeprecationWarning")
def test_the_residuals_have_exact_derivatives():
    model = plate(*TRUTH)
    evidence = ModalEvidence.of(model, measured(noise=0.05))

    def of(position: torch.Tensor) -> torch.Tensor:
        return evidence.residual(model, model.space.to_si(position))

    place, step = torch.tensor([0.4, 0.37, 0.3], dtype=torch.float64), 1e-5
    found = torch.func.jacfwd(of)(place)
    shifts = step * torch.eye(3, dtype=torch.float64)
    differences = torch.stack([(of(place + one) - of(place - one)) / (2 * step) for one in shifts], dim=-1)
    # Central differences are right to about step².
    torch.testing.assert_close(found, differences, rtol=1e-4, atol=1e-6)


@pytest.mark.check
def test_frequencies_and_shapes_find_the_parameters_of_a_plate():
    model = plate(*TRUTH)
    found = identify(
        model, search=LeastSquares(n_member=6), modal_model=measured((8, 3, 5, 4, 7, 6)), n_generation=25, seed=1
    )
    values = {name: one.value for name, one in found.parameters.items()}
    # Exact data: what is left is where least squares stops.
    assert values == pytest.approx(TRUTH, rel=1e-3)
    assert found.gap is not None
    assert found.gap < 1e-5
    assert found.modes is not None
    assert [pair.mode for pair in found.modes] == [9, 4, 6, 5, 8, 7]
    assert any("tells no scatter" in caveat for caveat in found.caveats)


def test_told_standard_deviations_are_those_of_the_values():
    model = plate("plate.youngs_modulus")
    told = ModalEvidence.of(model, measured(), frequency_std=0.002, shape_std=0.05)
    found = identify(model, search=LeastSquares(n_member=2), modal_model=told, n_generation=10)
    value = found.parameters["plate.youngs_modulus"]
    # Six frequencies, each to 0.2 % and as the root of E: 2 · 0.2 % / √6; shapes do not change with E.
    assert value.std == pytest.approx(2.04e11 * 0.004 / 6**0.5, rel=0.01)
    assert not any("tells no scatter" in caveat for caveat in found.caveats)


def test_noise_of_the_told_size_leaves_residuals_of_the_told_variance():
    model = plate()
    evidence = ModalEvidence.of(model, measured(noise=0.05), frequency_std=0.002, shape_std=0.05)
    variance, group = evidence.variance()
    ratio = evidence.residual(model, model.known.new_zeros(0)).square()[group == 1] / variance[group == 1]
    # The mean of 90 squares scatters by √(2/90), 15 %; six of the degrees of freedom are the shapes' scales.
    assert float(ratio.mean()) == pytest.approx(1.0, abs=0.45)


def test_a_table_and_a_modal_model_are_not_both_taken():
    model = plate()
    with pytest.raises(ValueError, match="got both"):
        Evidence(
            natural_frequencies=NaturalFrequencies.from_mapping({4: 80.0}),
            modal_model=ModalEvidence.of(model, measured()),
        )


def test_a_standard_deviation_of_nothing_is_refused():
    with pytest.raises(ValueError, match="shape_std above 0"):
        ModalEvidence.of(plate(), measured(), shape_std=0.0)


def test_an_objective_with_shapes_is_batched():
    model = plate(*TRUTH)
    objective = Objective(model, Evidence(modal_model=ModalEvidence.of(model, measured(noise=0.03))))
    theta = model.space.to_si(torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))
    whole = objective(theta)
    torch.testing.assert_close(whole, torch.stack([objective(one) for one in theta]))
    assert bool((whole > objective(torch.tensor(list(TRUTH.values()), dtype=torch.float64))).all())
