"""Columns of the nuisances are the derivatives of the FRFs, by differences of models in which they are real."""

import pytest
import torch

from torchplate.discrepancy import OfChannels, Specimens
from torchplate.discrepancy.modal_change import _multiples
from torchplate.discrepancy.nuisance import Nuisances, matrix_columns, nuisances
from torchplate.discrepancy.wandering import UNIFORM, Wandering
from torchplate.effects import CATALOGUE
from torchplate.measurement import PERFECT, Imperfections
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh

RESPONSE, REFERENCE = [3, 17], [7, 9, 21]
LINES = torch.linspace(20.0, 300.0, 240, dtype=torch.float64)
NOBODY = torch.zeros(0, dtype=torch.float64)
KNOWN = {
    "plate.youngs_modulus": 2.05e11,
    "plate.poisson_ratio": 0.3,
    "plate.density": 7860.0,
    "plate.thickness": 0.0027,
    "wires.stiffness": 1300.0,
    "wires.viscous_damping": 0.5,
    "loss.stiffness_loss_factor": 3e-3,
    "grain.young_ratio": 1.0,
    "grain.shear_factor": 1.0,
    "delay.delay": 1e-4,
}
SIDES = (0.48, 0.4)
# Of a column, what differences of models leave of it.
DIFFERENCED = 1e-4


def plate(*searched: str, at=(2, 10, 61, 69), kind="accelerance") -> PlateModel:
    effects = {
        "plate": CATALOGUE["plate"](),
        "wires": CATALOGUE["support_spring"](at=at)
        if isinstance(at[0], tuple)
        else CATALOGUE["support_spring"](nodes=at),
        "loss": CATALOGUE["hysteretic_damping"](),
        "grain": CATALOGUE["orthotropy"](),
        "delay": CATALOGUE["time_delay"](),
    }
    known = {key: value for key, value in KNOWN.items() if key not in searched}
    box = {key: Searched(0.5 * KNOWN[key], 1.5 * KNOWN[key]) for key in searched}
    return PlateModel(Mesh(*SIDES, 8, 7), effects, known, box, RESPONSE, REFERENCE, kind)


def found(imperfections=PERFECT, wandering=UNIFORM, mesh=0.0):
    return as_complex(nuisances(plate(), NOBODY, LINES, imperfections, wandering, torch.full_like(LINES, mesh)))


def as_complex(one: Nuisances) -> Nuisances:
    """Its columns as complex numbers, which FRFs are."""
    names = ("common", "by_response", "by_reference")
    return one._replace(**{name: torch.complex(*getattr(one, name).unbind(-2)) for name in names})


def change(name: str) -> torch.Tensor:
    """dH / d ln of a parameter."""
    model, step = plate(name), 1e-5
    at = torch.tensor([[KNOWN[name] * (1 + step)], [KNOWN[name] * (1 - step)]], dtype=torch.float64)
    above, below = model.frf(at, LINES)
    return (above - below) / (2 * step)


def off(one: torch.Tensor, other: torch.Tensor) -> float:
    return float((one - other).norm() / other.norm())


def test_grain_changes_what_orthotropy_changes():
    columns = found(wandering=Wandering(0.0, 0.0, 0.02, 0))
    assert columns.group[0] == ("grain", "grain")
    for index, name in enumerate(("grain.young_ratio", "grain.shear_factor")):
        assert off(columns.common[..., index], 0.02 * change(name)) < DIFFERENCED


def test_damping_of_all_modes_together_is_the_damping_of_the_model():
    """Modes beyond the band are not scattered: what they add to damping in the band is some per cent."""
    columns = found(Imperfections(0.0, 0.0, 0.0, 0.1))
    assert set(columns.group[0]) == {"damping_scatter"}
    both = change("loss.stiffness_loss_factor") + change("wires.viscous_damping")
    assert off(columns.common.sum(-1), 0.1 * both) < 5e-2


def test_damping_of_a_mode_changes_frfs_with_all_that_couples_it():
    """A column off by a per cent hides little of a peak a hundred times above the noise."""
    columns = found(Imperfections(0.0, 0.0, 0.0, 0.1)).common
    model, step = plate(), 1e-4
    for mode in range(columns.shape[-1]):
        factor = torch.ones(2, columns.shape[-1], dtype=torch.float64)
        factor[:, mode] = torch.tensor([step, -step], dtype=torch.float64).exp()
        above, below = (model.with_damping_factors(one).frf(NOBODY, LINES) for one in factor)
        assert off(columns[..., mode], 0.1 * (above - below) / (2 * step)) < DIFFERENCED


def test_a_grain_turns_the_damping_that_each_mode_has_of_its_own():
    """Else another ratio of the sides, which changes FRFs as a grain does, is told from one by a hundredth of that."""
    plain, step = plate(), 1e-5
    # Nearly a square: modes that bend along x lie beside those that bend along y.
    mesh, known = Mesh(0.48, 0.47, 8, 7), KNOWN | {"loss.stiffness_loss_factor": 1e-2}
    factor = (0.3 * torch.randn(20, generator=torch.Generator().manual_seed(4), dtype=torch.float64)).exp()

    def damped(*searched: str) -> PlateModel:
        box = {key: Searched(0.5, 1.5) for key in searched}
        kept = {key: value for key, value in known.items() if key not in searched}
        return PlateModel(mesh, plain.effects, kept, box, RESPONSE, REFERENCE, "accelerance").with_damping_factors(
            factor
        )

    told, wander = Imperfections(0.0, 0.0, 0.0, 0.0), Wandering(0.0, 0.0, 0.01, 0)
    columns = as_complex(nuisances(damped(), NOBODY, LINES, told, wander, torch.zeros_like(LINES))).common
    for index, name in enumerate(("grain.young_ratio", "grain.shear_factor")):
        at = torch.tensor([[1 + step], [1 - step]], dtype=torch.float64)
        above, below = damped(name).frf(at, LINES)
        assert off(columns[..., index], 0.01 * (above - below) / (2 * step)) < DIFFERENCED


@pytest.mark.parametrize(
    "viscous", [pytest.param(0.0, marks=pytest.mark.check), 1e-6, pytest.param(1e-5, marks=pytest.mark.check)]
)
@pytest.mark.check
def test_a_lossy_patch_couples_the_modes_that_a_grain_changes(viscous):
    """Modes beside one another give each other what the patch loses: without that columns are a quarter wrong."""
    told, step = Imperfections(0.0, 0.0, 0.0, 0.0), 1e-4
    effects = plate().effects | {"patch": CATALOGUE["damping_patch"](), "viscous": CATALOGUE["viscous_damping"]()}
    patch = {"patch.x": 0.3, "patch.y": 0.4, "patch.size": 0.3, "patch.loss_factor": 0.3, "patch.aspect": 1.0}
    whole = {"viscous.mass_coefficient": 0.0, "viscous.stiffness_coefficient": viscous}
    mesh, wander = Mesh(0.48, 0.47, 8, 7), Wandering(0.0, 0.0, 0.01, 0)
    model = PlateModel(mesh, effects, KNOWN | patch | whole, {}, RESPONSE, REFERENCE, "accelerance")
    factor = (0.3 * torch.randn(20, generator=torch.Generator().manual_seed(4), dtype=torch.float64)).exp()
    damped, specimens = model.with_damping_factors(factor), Specimens(model, NOBODY, wander)
    columns = as_complex(nuisances(damped, NOBODY, LINES, told, wander, torch.zeros_like(LINES))).common
    for index in range(2):
        shift = torch.zeros(2, dtype=torch.float64)
        shift[index] = step
        above, below = (specimens.at(one).with_damping_factors(factor).frf(NOBODY, LINES) for one in (shift, -shift))
        # Where the lines do not share complex modes, each turns a little from those amid the band.
        assert off(columns[..., index], (above - below) / (2 * step)) < DIFFERENCED


def test_a_loss_that_is_spread_is_multiplied_by_what_each_mode_has_of_its_own():
    factor = (0.3 * torch.randn(20, generator=torch.Generator().manual_seed(4), dtype=torch.float64)).exp()
    name, step = "loss.stiffness_loss_factor", 1e-6
    system = plate().assembly.system(*plate().plan(NOBODY))
    stiffness = system.stiffness[None]
    column = matrix_columns(
        plate().with_damping_factors(factor), NOBODY, LINES, stiffness, torch.zeros_like(stiffness), lossy=True
    )[0]
    at = torch.tensor([[KNOWN[name] + step], [KNOWN[name] - step]], dtype=torch.float64)
    above, below = plate(name).with_damping_factors(factor).frf(at, LINES)
    assert off(column, (above - below) / (2 * step)) < DIFFERENCED


def test_what_modes_beyond_twice_the_band_scatter_is_less_than_the_noise_shows():
    """With much viscous damping of the stiffness modes above the band are as wide as their distance from it."""
    plain = plate()
    effects = plain.effects | {"viscous": CATALOGUE["viscous_damping"]()}
    known = KNOWN | {"viscous.mass_coefficient": 0.0, "viscous.stiffness_coefficient": 1e-5}
    model = PlateModel(plain.mesh, effects, known, {}, RESPONSE, REFERENCE, "accelerance")
    told, step, left = Imperfections(0.0, 0.0, 0.0, 0.15), 1e-4, []
    columns = as_complex(nuisances(model, NOBODY, LINES, told, UNIFORM, torch.zeros_like(LINES))).common
    frf = model.frf(NOBODY, LINES)
    noise = 0.005 * (0.5 * (frf.abs().square() + frf.abs().square().mean(0))).sqrt()
    for seed in range(8):
        drawn = torch.randn(100, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        above, below = (
            model.with_damping_factors((sign * step * drawn).exp()).frf(NOBODY, LINES) for sign in (1.0, -1.0)
        )
        known_of = columns @ drawn[: columns.shape[-1]].to(columns)
        left.append(((known_of - 0.15 * (above - below) / (2 * step)) / noise).abs().square().mean())
    # Of the noise's own sum of squares a two-hundredth, which no χ² tells from chance; up to a tenth above the band as
    # many as a seventieth were left.
    assert float(torch.stack(left).mean()) < 1 / 200


def test_a_mesh_that_shifts_every_mode_is_another_modulus_to_the_free_plate():
    columns = found(mesh=1e-4)
    elastic = change("plate.youngs_modulus") + change("wires.stiffness")
    # ln f moves by half of ln E; rigid-body modes and modes beyond the band stay.
    upper = LINES > 40
    assert off(columns.common.sum(-1)[upper], 2e-4 * elastic[upper]) < 0.05


@pytest.mark.parametrize("axis", [0, 1])
def test_places_of_sensors_and_hits_move_readings_by_the_slope(axis):
    columns, model = found(Imperfections(2e-3, 0.0, 0.0, 0.0)), plate()
    assert columns.group[1] == columns.group[2] == ("position_std", "position_std")
    step = torch.zeros(2, dtype=torch.float64)
    step[axis] = 1e-6
    for name, points, own in (
        ("response", RESPONSE, columns.by_response),
        ("reference", REFERENCE, columns.by_reference),
    ):
        place = model.mesh.places(points)
        above, below = (model.frf(NOBODY, LINES, **{name: place + sign * step}) for sign in (1, -1))
        expected = (above - below) / 2e-6 * 2e-3 / SIDES[axis]
        assert off(own[..., axis], expected) < DIFFERENCED


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("far", [0.0, 3e-3])
def test_what_a_support_off_its_mark_changes_is_what_moving_it_does(axis, far):
    """About its mark, and about where it was found."""
    std, step = 2e-3, 1e-5
    told = Imperfections(std, 0.0, 0.0, 0.0)
    sides = torch.tensor(SIDES, dtype=torch.float64)
    there = torch.zeros(4, 2, dtype=torch.float64)
    there[2] = far / sides
    model = plate().with_places_off(torch.zeros(2, 2).to(NOBODY), torch.zeros(3, 2).to(NOBODY), there)
    columns = as_complex(nuisances(model, NOBODY, LINES, told, UNIFORM, torch.zeros_like(LINES)))
    assert len(columns.support) == 4
    assert columns.of_support == (std / SIDES[0], std / SIDES[1])
    moved = torch.zeros(4, 2, dtype=torch.float64)
    moved[2, axis] = step / SIDES[axis]
    nowhere = model.off_marks
    above, below = (
        plate().with_places_off(nowhere.response, nowhere.reference, there + sign * moved).frf(NOBODY, LINES)
        for sign in (1, -1)
    )
    wanted = std * (above - below) / (2 * step)
    assert off(columns.common[..., columns.support[2][axis]], wanted) < 2 * DIFFERENCED


@pytest.mark.parametrize("axis", [0, 1])
def test_what_a_sensor_weighs_moves_with_it(axis):
    """A mass at the second response's mark: all FRFs feel where it sits, and its own ones where it reads, too."""
    bare = plate()
    mark = bare.mesh.places([RESPONSE[1]])[0]
    effects = bare.effects | {"sensor": CATALOGUE["point_mass"](), "lump": CATALOGUE["point_mass"]()}
    own = {"sensor.x": float(mark[0]), "sensor.y": float(mark[1]), "sensor.mass": 0.03}
    elsewhere = {"lump.x": 0.37, "lump.y": 0.8, "lump.mass": 0.02}
    model = PlateModel(bare.mesh, effects, KNOWN | own | elsewhere, {}, RESPONSE, REFERENCE, "accelerance")
    assert model.carried() == {"sensor": 1}
    std, step = 2e-3, 1e-5
    told = Imperfections(std, 0.0, 0.0, 0.0)
    columns = as_complex(nuisances(model, NOBODY, LINES, told, UNIFORM, torch.zeros_like(LINES)))
    moved = torch.zeros(2, 2, dtype=torch.float64)
    moved[1, axis] = step / SIDES[axis]
    still = torch.zeros(3, 2, dtype=torch.float64)
    above, below = (model.with_places_off(sign * moved, still).frf(NOBODY, LINES) for sign in (1, -1))
    wanted = std * (above - below) / (2 * step)
    # A product of two sums over uncoupled modes is off by twice as much as one.
    assert off(columns.common[..., columns.carried[1] + axis], wanted) < 2 * DIFFERENCED
    # The readings of the first response change by the mass alone, which is not among what that response has of its own.
    assert float(wanted[:, 0].norm()) > 0.01 * float(wanted[:, 1].norm())
    assert float(columns.by_response[:, 1, :, axis].abs().max()) == 0
    assert float(columns.by_response[:, 0, :, axis].abs().max()) > 0


@pytest.mark.parametrize("swapped", [[(3, None), (17, None)], [(None, 7), (None, 21)]], ids=["sensors", "hits"])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.check
def test_places_of_exchanged_channels_are_those_where_they_are_read(axis, swapped):
    """What is put into a model in the end is what the columns say; one of the sensors weighs something, too."""
    bare = plate()
    mark = bare.mesh.places([RESPONSE[1]])[0]
    effects = bare.effects | {
        "sensor": CATALOGUE["point_mass"](),
        "cables": CATALOGUE["channel_swap"](channels=swapped),
    }
    own = {"sensor.x": float(mark[0]), "sensor.y": float(mark[1]), "sensor.mass": 0.03}
    model = PlateModel(bare.mesh, effects, KNOWN | own, {}, RESPONSE, REFERENCE, "accelerance")
    std, step = 2e-3, 5e-3
    told = Imperfections(std, 0.0, 0.0, 0.0)
    columns = as_complex(nuisances(model, NOBODY, LINES, told, UNIFORM, torch.zeros_like(LINES)))
    specimens = Specimens(model, NOBODY, UNIFORM, place=std)
    for side, n in (("response", 2), ("reference", 3)):
        for index in range(n):
            here = {name: torch.zeros(count, 2).to(NOBODY) for name, count in (("response", 2), ("reference", 3))}
            here[side][index, axis] = step
            nothing, names = [torch.zeros_like(one) for one in here.values()], ("x", "y")
            above, below = (
                specimens.at(NOBODY, OfChannels(*(sign * one for one in here.values()), *nothing, names, names)).frf(
                    NOBODY, LINES
                )
                for sign in (1, -1)
            )
            wanted, along = (above - below) / (2 * step), torch.zeros_like(above)
            if side == "reference":
                along[:, :, index] = columns.by_reference[:, :, index, axis]
            elif index in columns.carried:
                along = columns.common[..., columns.carried[index] + axis]
            else:
                along[:, index] = columns.by_response[:, index, :, axis]
            assert off(along, wanted) < 2 * DIFFERENCED, (side, index)


def test_wires_off_their_marks_change_what_wires_elsewhere_do():
    columns = found(Imperfections(2e-3, 0.0, 0.0, 0.0))
    places = [tuple(one) for one in plate().mesh.places([2, 10, 61, 69]).tolist()]
    moved = list(places)
    step = 1e-5
    moved[0] = (places[0][0] + step, places[0][1])
    back = [(places[0][0] - step, places[0][1]), *places[1:]]
    expected = (plate(at=tuple(moved)).frf(NOBODY, LINES) - plate(at=tuple(back)).frf(NOBODY, LINES)) / (2 * step)
    expected = expected * 2e-3 / SIDES[0]
    assert columns.group[0] == ("position_std",) * 8
    assert off(columns.common[..., 0], expected) < 2 * DIFFERENCED


def test_drift_stretches_the_frequency_axis_of_one_record_and_calibration_its_level():
    columns = found(Imperfections(0.0, 1e-3, 0.03, 0.0))
    both = ("calibration_std", "frequency_drift")
    assert columns.group == ((), both, both)
    reading = plate().frf(NOBODY, LINES)
    assert off(columns.by_reference[..., 0], 0.03 * reading) < DIFFERENCED
    elastic = change("plate.youngs_modulus") + change("wires.stiffness")
    assert off(columns.by_reference[..., 1], 2e-3 * elastic) < DIFFERENCED


def test_a_perfect_test_of_a_uniform_plate_has_no_nuisances():
    columns = found()
    assert columns.group == ((), (), ())
    assert float(columns.second_order.variance({}).abs().max()) == 0.0


def test_the_second_order_is_what_the_first_leaves_out_and_scales_with_the_size():
    columns = found(mesh=1e-3)
    full, half = (columns.second_order.variance({"mesh": size}) for size in (1.0, 0.5))
    # Where modes move by less than their width it goes as the fourth power, beyond it as the square.
    ratio = float(full.sum() / half.sum())
    assert 4.0 < ratio < 16.0
    small = [columns.second_order.variance({"mesh": size}).sum() for size in (1e-3, 5e-4)]
    assert float(small[0] / small[1]) == pytest.approx(16.0, rel=0.02)


@pytest.mark.check
def test_places_far_off_are_second_order_too():
    """Mean square over draws of what first order leaves, at places off by a fiftieth of a side."""
    size = 0.01
    columns, model = found(Imperfections(size, 0.0, 0.0, 0.0)), plate()
    reading = model.frf(NOBODY, LINES)
    generator = torch.Generator().manual_seed(1)
    places = [model.mesh.places(points) for points in (RESPONSE, REFERENCE)]
    sides = torch.tensor(SIDES, dtype=torch.float64)
    left = torch.zeros_like(reading.real)
    n_draw = 60
    for _ in range(n_draw):
        off = [torch.randn(*one.shape, generator=generator, dtype=torch.float64) for one in places]
        moved = [place + size * one / sides for place, one in zip(places, off, strict=True)]
        first = torch.einsum("fjrk,jk->fjr", columns.by_response, off[0].to(reading))
        first = first + torch.einsum("fjrk,rk->fjr", columns.by_reference, off[1].to(reading))
        there = model.frf(NOBODY, LINES, response=moved[0], reference=moved[1])
        left += (there - reading - first).abs().square() / n_draw
    said = 2 * columns.second_order.variance({})
    # Mean over lines and FRFs; the mean of 60 draws of a fourth power is good to a third.
    assert float(said.mean() / left.mean()) == pytest.approx(1.0, abs=0.4)


def test_matrices_that_are_multiples_of_one_another_are_felt_once():
    generator = torch.Generator().manual_seed(2)
    one, other = (torch.randn(4, 4, generator=generator, dtype=torch.float64) for _ in range(2))
    nothing = torch.zeros_like(one)
    own, which, multiple = _multiples(
        torch.stack([nothing, one, other, -2.5 * one, nothing, 1e-9 * other, one + other])
    )
    assert own.tolist() == [1, 2, 6]
    assert multiple.tolist() == pytest.approx([0.0, 1.0, 1.0, -2.5, 0.0, 1e-9, 1.0])
    assert [which[k].item() for k in (1, 2, 3, 5, 6)] == [0, 1, 0, 1, 2]


def test_what_all_records_drift_is_no_drift_of_theirs():
    one = OfChannels(
        torch.zeros(1, 2), torch.tensor([[0.5, 1.0], [0.0, 2.0], [0.3, 0.0]]), torch.ones(1, 2), torch.ones(3, 2),
        ("x", "y"), ("x", "drift"), drift=2e-4,
    )  # fmt: skip
    apart = one.from_each_other()
    # Of the third nothing was seen.
    assert apart.reference[:, 1].tolist() == [-0.5, 0.5, 0.0]
    assert torch.equal(apart.reference[:, 0], one.reference[:, 0])
