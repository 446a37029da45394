"""The assurance criteria are 1 where a model is right, and say in their own way where it is not."""

import numpy as np
import pytest
import torch

from torchplate.diagnosis.assurance import N_LINE, csac_by_line, csf_by_line, fdac, fdac_frequency, frac_by_channel
from torchplate.discrepancy import Measured, csac, csf, frac
from torchplate.effects import CATALOGUE

EXACT = {"rtol": 0, "atol": 1e-12}
"""A sum of some ten products of numbers near one, in double precision."""


def drawn(seed, *shape):
    """Complex numbers in every direction."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.complex128)


def measurement(lab, frf, **others):
    """Of FRFs of any size, on lines from 20 Hz."""
    n_line, n_response, n_reference = frf.shape
    frequency = 20.0 + 3.0 * torch.arange(n_line, dtype=torch.float64)
    return lab.measured(frequency, frf, lab.nodes[:n_response], lab.nodes[-n_reference:], **others)


def test_an_equal_model_has_ones(lab):
    frf = drawn(1, 7, 2, 3)
    measured = measurement(lab, frf)
    for found in (frac_by_channel(measured, frf), csac_by_line(measured, frf), csf_by_line(measured, frf)):
        torch.testing.assert_close(found, torch.ones_like(found), **EXACT)
    table = fdac(measured, frf)
    torch.testing.assert_close(table.diagonal(), torch.ones(7, dtype=torch.float64), **EXACT)
    # Random shapes of six numbers agree in a sixth of their square.
    assert 0.05 < float(table[~torch.eye(7, dtype=torch.bool)].mean()) < 0.35


@pytest.mark.parametrize("size", [0.4, 2.7])
def test_the_level_counts_in_the_csf_alone(lab, size):
    frf = drawn(2, 7, 2, 3)
    measured = measurement(lab, frf)
    model = frf * size * np.exp(0.8j)
    for found in (frac_by_channel(measured, model), csac_by_line(measured, model)):
        torch.testing.assert_close(found, torch.ones_like(found), **EXACT)
    torch.testing.assert_close(fdac(measured, model), fdac(measured, frf), **EXACT)
    expected = torch.full((7,), 2 * size / (1 + size**2), dtype=torch.float64)
    torch.testing.assert_close(csf_by_line(measured, model), expected, **EXACT)


def test_orthogonal_shapes_have_zeros_at_their_line_alone(lab):
    frf = drawn(3, 5, 1, 2)
    model = frf.clone()
    # (a, b) and (−b*, a*) are orthogonal.
    model[3, 0, 0], model[3, 0, 1] = -frf[3, 0, 1].conj(), frf[3, 0, 0].conj()
    measured = measurement(lab, frf)
    expected = torch.tensor([1.0, 1.0, 1.0, 0.0, 1.0], dtype=torch.float64)
    for found in (csac_by_line(measured, model), csf_by_line(measured, model), fdac(measured, model).diagonal()):
        torch.testing.assert_close(found, expected, **EXACT)


def test_an_orthogonal_course_has_a_zero_at_its_frf_alone(lab):
    frf = drawn(4, 2, 3, 2)
    model = frf.clone()
    model[0, 1, 0], model[1, 1, 0] = -frf[1, 1, 0].conj(), frf[0, 1, 0].conj()
    expected = torch.ones(3, 2, dtype=torch.float64)
    expected[1, 0] = 0
    torch.testing.assert_close(frac_by_channel(measurement(lab, frf), model), expected, **EXACT)


def test_each_criterion_is_its_formula(lab):
    frf, model = drawn(5, 6, 2, 3), drawn(6, 6, 2, 3)
    measured = measurement(lab, frf)

    def agreement(one, other):
        return abs(np.vdot(one, other)) ** 2 / (np.vdot(one, one) * np.vdot(other, other)).real

    true, said = frf.numpy(), model.numpy()
    course = [[agreement(true[:, j, k], said[:, j, k]) for k in range(3)] for j in range(2)]
    table = [[agreement(said[a].ravel(), true[e].ravel()) for e in range(6)] for a in range(6)]
    scale = [
        2 * abs(np.vdot(one, other)) / (np.vdot(one, one) + np.vdot(other, other)).real
        for one, other in zip(true, said, strict=True)
    ]
    np.testing.assert_allclose(frac_by_channel(measured, model), course, **EXACT)
    np.testing.assert_allclose(csac_by_line(measured, model), np.diagonal(table), **EXACT)
    np.testing.assert_allclose(csf_by_line(measured, model), scale, **EXACT)
    np.testing.assert_allclose(fdac(measured, model), table, **EXACT)


def test_their_means_are_the_objectives(lab):
    frequency, ends = lab.lines(1.0), (list(lab.nodes[:2]), list(lab.nodes[2:12]))
    true, model = (
        lab.plate(4e-3, hidden).frf(lab.nobody, frequency, *ends)
        for hidden in ({"magnet": (CATALOGUE["point_mass"](), {"x": 0.27, "y": 0.68, "mass": 0.02})}, None)
    )
    measured = lab.measured(frequency, true, *ends)
    for parts, whole in ((frac_by_channel, frac), (csac_by_line, csac), (csf_by_line, csf)):
        mean = float(parts(measured, model).mean())
        assert 0 < mean < 0.999
        assert 1 - mean == pytest.approx(float(whole(model, Measured.of(measured))), abs=1e-12)


def test_frfs_that_were_not_measured_do_not_count(lab):
    frf, model = drawn(7, 6, 2, 3), drawn(8, 6, 2, 3)
    pairs = torch.tensor([[True, False, True], [True, True, False]])
    wild = torch.where(pairs, model, 1e3 * drawn(9, 6, 2, 3))
    measured = measurement(lab, frf, measured=pairs)
    for criterion in (frac_by_channel, csac_by_line, csf_by_line, fdac):
        torch.testing.assert_close(criterion(measured, wild), criterion(measured, model), **EXACT)
    torch.testing.assert_close(frac_by_channel(measured, wild) > 0, pairs)
    # Those four alone make the shape.
    kept = [frf[:, pairs][:, None], model[:, pairs][:, None]]
    torch.testing.assert_close(fdac(measured, wild), fdac(measurement(lab, kept[0]), kept[1]), **EXACT)


def test_a_line_without_a_model_is_zero_and_not_nan(lab):
    frf = drawn(10, 4, 1, 2)
    model = frf.clone()
    model[0] = 0
    measured = measurement(lab, frf)
    expected = torch.tensor([0.0, 1.0, 1.0, 1.0], dtype=torch.float64)
    for found in (csac_by_line(measured, model), csf_by_line(measured, model), fdac(measured, model).diagonal()):
        torch.testing.assert_close(found, expected, **EXACT)


def test_the_ridge_of_a_model_with_lower_frequencies_is_off_the_diagonal_by_as_much(lab):
    # Lines in steps of √0.98: the model reaches the shape of each measured line two lines lower, at 0.98 of it.
    n_line, shift, off = 180, 0.98, 2
    frequency = 60.0 * shift ** (-torch.arange(n_line, dtype=torch.float64) / off)
    ends = (list(lab.nodes[:2]), list(lab.nodes[2:12]))
    plate = lab.plate(4e-3)
    true, lower = (plate.frf(lab.nobody, lines, *ends) for lines in (frequency, frequency / shift))
    measured = lab.measured(frequency, true, *ends)
    table, line = fdac(measured, lower), fdac_frequency(measured)
    ridge = line[table.argmax(0)][off:] / line[off:]
    torch.testing.assert_close(ridge, torch.full_like(ridge, shift), rtol=1e-12, atol=0)
    # Row and column two apart are the same shape but for rounding, and the diagonal is left.
    assert float(table.diagonal(off).min()) > 1 - 1e-9
    assert float(table.diagonal().min()) < 0.9


def test_many_lines_are_thinned_evenly(lab):
    frf, model = drawn(11, 2 * N_LINE + 5, 1, 3), drawn(12, 2 * N_LINE + 5, 1, 3)
    measured = measurement(lab, frf)
    table, line = fdac(measured, model), fdac_frequency(measured)
    assert table.shape == (len(line), len(line)) == (135, 135)
    torch.testing.assert_close(line, measured.frequency[::3])
    torch.testing.assert_close(table.diagonal(), csac_by_line(measured, model)[::3], **EXACT)
    few = measurement(lab, frf[:N_LINE])
    assert fdac(few, model[:N_LINE]).shape == (N_LINE, N_LINE)
    torch.testing.assert_close(fdac_frequency(few), few.frequency)
