"""The marginal likelihood against the whole covariance matrix, and the scales that it finds."""

import pytest
import torch

from torchplate.discrepancy.judged import Judged, Knowledge
from torchplate.discrepancy.marginal import Marginal
from torchplate.discrepancy.nuisance import Nuisances
from torchplate.discrepancy.second_order import SecondOrder
from torchplate.discrepancy.specimen import Found, OfChannels

SHAPE = (9, 2, 3)


def complex_normal(generator, *shape):
    parts = (torch.randn(*shape, generator=generator, dtype=torch.float64) for _ in range(2))
    return torch.complex(*parts)


def none(shape) -> SecondOrder:
    nothing = torch.zeros(shape[0], 1, dtype=torch.float64)
    pairs = torch.zeros(shape[1] * shape[2], 1, dtype=torch.float64)
    none_of_all = torch.zeros(shape, dtype=torch.float64)
    return SecondOrder({}, nothing, True, nothing, nothing, nothing + 1, pairs, none_of_all, none_of_all + 1)


def marginal(seed=0, shape=SHAPE, size=1.0, fitted=None, freedom=None) -> Marginal:
    generator = torch.Generator().manual_seed(seed)
    columns = [
        torch.view_as_real(size * complex_normal(generator, *shape, k)).movedim(-1, -2).contiguous() for k in (2, 1, 2)
    ]
    group = (("a", "b"), ("a",), ("c", "d"))
    variance = 0.5 + torch.rand(shape, generator=generator, dtype=torch.float64)
    fitted = torch.ones(shape[1:], dtype=torch.bool) if fitted is None else fitted
    return Marginal(variance, Nuisances(*columns, group, none(shape)), fitted, freedom or {}, Knowledge())


def matrix(one: Marginal, scale: Judged | None = None) -> torch.Tensor:
    columns = one.across(torch.eye(len(one.group), dtype=torch.float64)).mT
    size = torch.ones(len(one.group), dtype=torch.float64)
    noise = 1.0
    if scale is not None:
        size = torch.tensor([scale.scale[one.names[k]] for k in one.group.tolist()], dtype=torch.float64)
        noise = scale.noise_scale**2
    return noise * torch.eye(len(columns), dtype=torch.float64) + (columns * size**2) @ columns.mT


@pytest.fixture
def residual():
    return torch.randn(2 * 9 * 6, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def test_products_with_the_columns_are_each_others_transposes(residual):
    one = marginal()
    columns = one.across(torch.eye(len(one.group), dtype=torch.float64)).mT
    assert len(one.group) == 2 + 2 * 1 + 3 * 2
    assert torch.allclose(one.along(residual), columns.mT @ residual)
    assert torch.allclose(one.gram, columns.mT @ columns)
    batch = torch.stack([residual, 2 * residual])
    assert torch.allclose(one.along(batch)[1], 2 * one.along(residual))


def test_whitening_is_the_inverse_root_of_the_covariance(residual):
    one = marginal()
    white = one.whitened(residual)
    assert float(white @ white) == pytest.approx(float(residual @ torch.linalg.solve(matrix(one), residual)))
    # The symmetric root: twice whitened is the inverse.
    assert torch.allclose(one.whitened(white), torch.linalg.solve(matrix(one), residual))


def test_the_cost_is_minus_twice_the_logarithm_of_the_likelihood(residual):
    one = marginal()
    judged = one.judge(residual)
    whole = matrix(one, judged)
    expected = float(torch.logdet(whole) + residual @ torch.linalg.solve(whole, residual))
    size = torch.tensor([judged.scale[name] for name in one.names], dtype=torch.float64)
    found = one._cost(float(residual @ residual), one.along(residual), size, judged.noise_scale**2)
    assert found - one._log_variance == pytest.approx(expected)


def test_levels_that_were_found_leave_the_likelihood_that_of_what_was_measured():
    """A model whose level is wrong gains nothing by the noise that is divided with the data."""
    plain, generator = marginal(), torch.Generator().manual_seed(11)
    variance, nuisances, fitted = plain._given
    response, reference = (torch.randn(n, 1, generator=generator, dtype=torch.float64) for n in SHAPE[1:])
    nothing = [torch.zeros_like(one) for one in (response, reference)]
    channels = OfChannels(response, reference, *nothing, ("level",), ("level",), level=0.3)
    empty = torch.zeros(0, dtype=torch.float64)
    about = Found(empty, empty[:, None], channels)
    one = Marginal(variance, nuisances, fitted, {}, Knowledge(), about=about)
    level = channels.level_of_pairs()
    assert float((level - 1).abs().min()) > 0.02
    measured = complex_normal(generator, *SHAPE)
    found = one.cost(one.over_noise(measured / level))
    # By the columns of other levels residuals are those of what was measured, too.
    before = Marginal(variance, nuisances, fitted, {}, Knowledge())
    assert torch.allclose(before.taken_about(about, None).over_noise(measured / level), before.over_noise(measured))
    # Of y itself: y = level (H + J ν) + e.
    columns = plain.across(torch.eye(len(plain.group), dtype=torch.float64)).mT
    both = torch.ones(*SHAPE, 2, dtype=torch.float64)
    std, times = ((part[..., None] * both).flatten() for part in (variance.sqrt(), level))
    inside = times[:, None] * std[:, None] * columns
    whole = torch.diag(std.square()) + inside @ inside.mT
    residual = torch.view_as_real(measured).flatten()
    expected = float(torch.logdet(whole) + residual @ torch.linalg.solve(whole, residual))
    assert found == pytest.approx(expected)


def test_the_information_is_that_of_the_whole_covariance(residual):
    one = marginal()
    judged = one.judge(residual)
    rows = torch.randn(3, len(residual), generator=torch.Generator().manual_seed(8), dtype=torch.float64)
    expected = rows @ torch.linalg.solve(matrix(one, judged), rows.mT)
    assert torch.allclose(one.precision(rows, judged), expected)


@pytest.mark.parametrize(("size", "noise"), [(1.0, 1.0), (0.1, 1.0), (2.5, 1.0), (1.0, 3.0)])
def test_scales_of_nuisances_and_noise_come_back(size, noise):
    """Some hundred numbers of each kind: good to a tenth."""
    shape, freedom = (60, 1, 80), {"c": 1.0, "d": 1.0}
    one = marginal(3, shape, freedom=freedom)
    generator = torch.Generator().manual_seed(11)
    value = size * torch.randn(len(one.group), generator=generator, dtype=torch.float64)
    drawn = noise * torch.randn(2 * 60 * 80, generator=generator, dtype=torch.float64) + one.across(value)
    judged = one.judge(drawn)
    assert judged.noise_scale == pytest.approx(noise, rel=0.05)
    for name in ("c", "d"):
        # One more number of the prior, about 1, beside the eighty or so of the data.
        expected = ((size**2 + 1 / 80) / (1 + 1 / 80)) ** 0.5
        assert judged.scale[name] == pytest.approx(expected, rel=0.25)
    known = one.group >= 2
    # Nuisances a tenth of the noise of a line are known from 120 lines each.
    assert torch.corrcoef(torch.stack([judged.shift[known], value[known]]))[0, 1] > 0.7


def test_a_scale_that_is_known_exactly_stays():
    one = marginal(freedom={"a": float("inf")})
    drawn = one.across(9.0 * torch.ones(len(one.group), dtype=torch.float64))
    assert one.judge(drawn).scale["a"] == 1.0


def test_frfs_that_do_not_count_change_nothing(residual):
    fitted = torch.tensor([[True, False, True], [True, True, True]])
    one = marginal(fitted=fitted)
    off = complex_normal(torch.Generator().manual_seed(2), *SHAPE)
    other = off.clone()
    other[:, 0, 1] += 100.0
    assert torch.equal(one.over_noise(off), one.over_noise(other))
    assert one.n == 2 * 9 * 5
    assert one.judge(one.over_noise(off)).cost == one.judge(one.over_noise(other)).cost


def test_smaller_nuisances_let_residuals_count_more(residual):
    one = marginal(size=3.0)
    less = one.rescaled(dict.fromkeys(one.names, 0.1))
    assert float(less.whitened(residual).norm()) > float(one.whitened(residual).norm())
    # The evidence finds the scales by itself, wherever it begins.
    assert less.judge(residual).cost == pytest.approx(one.judge(residual).cost, abs=0.05)


def test_expected_power_is_noise_and_nuisances():
    one = marginal()
    expected = matrix(one).diagonal().unflatten(0, (*SHAPE, 2)).sum(-1) / one.weight.square()
    assert torch.allclose(one.power(), expected)


def test_channels_that_are_put_in_cost_what_they_are_and_those_farther_off_are_linear(residual):
    plain, generator = marginal(), torch.Generator().manual_seed(13)
    variance, nuisances, fitted = plain._given
    nuisances = nuisances._replace(of_response=("x",), of_reference=("x", "y"))
    one = Marginal(variance, nuisances, fitted, {}, Knowledge())
    response, reference = (torch.randn(*shape, generator=generator, dtype=torch.float64) for shape in ((2, 1), (3, 2)))
    channels = OfChannels(response, reference, 0 * response, 0 * reference, ("x",), ("x", "y"))
    columns = one.across(torch.eye(len(one.group), dtype=torch.float64)).mT
    off = torch.view_as_complex(residual.reshape(*SHAPE, 2)) / one.weight
    unit = torch.eye(len(residual), dtype=torch.float64)
    for farthest in (10.0, float(reference.abs().max())):
        at = torch.cat([torch.zeros(2).double(), response.flatten(), reference.flatten()])
        # The farthest is linear about itself.
        linear = torch.tensor([True, True, *(at[2:].abs() >= farthest).tolist()])
        assert int(linear.sum()) == (2 if farthest == 10.0 else 3)
        kept, whole = columns[:, linear], residual + columns[:, linear] @ at[linear]
        expected = whole @ torch.linalg.solve(unit + kept @ kept.mT, whole) + at[~linear].square().sum()
        assert one.misfit(off, channels, farthest) == pytest.approx(float(expected))
    # As they are meant: nothing of theirs, and nothing that they may be.
    kept = columns[:, :2]
    expected = residual @ torch.linalg.solve(unit + kept @ kept.mT, residual)
    assert one.misfit(off, None) == pytest.approx(float(expected))


def test_a_level_is_put_in_as_far_as_it_goes():
    nothing = torch.zeros(1, 2, dtype=torch.float64)
    far = torch.tensor([[30.0, -60.0]], dtype=torch.float64)
    one = OfChannels(far, 0 * nothing, nothing, nothing, ("x", "level"), ("x", "level"), level=0.01)
    assert one.within(10.0).response.tolist() == [[10.0, -60.0]]
    # A level is never of the other sign.
    turned = one._replace(response=torch.tensor([[-30.0, -200.0]], dtype=torch.float64)).within(10.0)
    assert turned.response[0, 0] == -10.0
    assert float(turned.level_of_pairs()) == pytest.approx(0.05)


def test_what_the_second_order_adds_can_stay_what_it_was(residual):
    one = marginal()
    variance, nuisances, fitted = one._given
    more = Marginal(4 * variance, nuisances, fitted, {}, Knowledge())
    held = one.with_variance(more.variance)
    assert torch.equal(held.weight, more.weight)
    # The columns are its own still.
    assert torch.allclose(held.across(torch.ones(len(one.group)).double()), 0.5 * one.across(torch.ones(10).double()))
    # Beside twice the size, noise counts for four.
    assert held.cost(0.5 * residual) == pytest.approx(more.cost(0.5 * residual))


def test_where_more_than_noise_is_left_channels_are_known_no_better_than_beside_it(residual):
    plain = marginal()
    variance, nuisances, fitted = plain._given
    nuisances = nuisances._replace(of_response=("x",), of_reference=("x", "y"))
    one = Marginal(variance, nuisances, fitted, {}, Knowledge())
    near, far = (one.channels(times * residual) for times in (1.0, 30.0))
    # Means are those of the likelihood that is minimised.
    assert torch.allclose(far.response, 30 * near.response)
    assert bool((far.response_left > 2 * near.response_left).all())
    assert bool((far.reference_left < 1).all())


def test_what_is_put_in_leaves_the_likelihood_of_what_was_measured(residual):
    """Nuisances that all FRFs share may be taken about where they were found: what is linear in them stays the same."""
    plain = marginal()
    columns = complex_normal(torch.Generator().manual_seed(8), *SHAPE, 3)
    put_in = torch.tensor([0.7, -1.9, 0.4], dtype=torch.float64)
    off = torch.view_as_complex(residual.reshape(*SHAPE, 2))
    before, after = plain.beside(columns, "told"), plain.beside(columns, "told", put_in)
    whole, left = before.residual(off), after.residual(off - columns @ put_in.to(columns))
    assert torch.allclose(whole, left)
    assert not torch.allclose(whole, before.residual(off - columns @ put_in.to(columns)))
    assert after.judge(left).cost == pytest.approx(before.judge(whole).cost, rel=1e-12)
    # Among others of another size too.
    larger = after.rescaled({"a": 2.0}).residual(off - columns @ put_in.to(columns))
    assert torch.allclose(larger, before.rescaled({"a": 2.0}).residual(off))


def test_a_whole_step_leads_to_what_is_most_probable_and_a_damped_one_part_of_the_way(residual):
    """Where all is linear one step is enough; what was put in is then as probable as it becomes."""
    plain = marginal()
    columns = complex_normal(torch.Generator().manual_seed(8), *SHAPE, 3)
    off = torch.view_as_complex(residual.reshape(*SHAPE, 2))

    def at(put_in):
        return plain.beside(columns, "told", put_in), off - columns @ put_in.to(columns)

    begun = torch.tensor([0.7, -1.9, 0.4], dtype=torch.float64)
    one, left = at(begun)
    to, _ = one.towards(left, 0.0)
    part, _ = one.towards(left, 5.0)
    best = at(to)[0].held(at(to)[1])
    assert one.held(left) > at(part)[0].held(at(part)[1]) > best
    assert torch.allclose(at(to)[0].towards(at(to)[1], 0.0)[0], to)
    # Columns that are the same wherever they are taken need not be made anew.
    moved = one.taken_about(None, to)
    assert moved.held(at(to)[1]) == pytest.approx(best, rel=1e-12)
    assert torch.allclose(moved.residual(at(to)[1]), at(to)[0].residual(at(to)[1]))
    for index in range(3):
        for step in (-0.02, 0.02):
            beside = to.clone()
            beside[index] += step
            assert at(beside)[0].held(at(beside)[1]) > best
