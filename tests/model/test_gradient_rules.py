"""The custom derivative rules alone, on well-scaled numbers where finite differences are sharp."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from torchplate.model.receptance import gradient
from torchplate.model.receptance.gradient import differentiable_receptance, frozen_modes, modal_impedance
from torchplate.model.receptance.impedance import Impedance
from torchplate.plate import Proportional, System

# torch's forward mode loads its own rules by torch.jit.script, which warns of itself.
pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit.script` is deprecated:DeprecationWarning")

N = 3


def draw(*shape: int, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def problem(batch: tuple[int, ...], *, n_dashpot: int, hysteretic: bool, repeated: bool) -> list[torch.Tensor]:
    """Stiffness, mass, dashpots, viscous, β, η, a, b, hysteretic, s, left, right, all of order one."""
    g = torch.Generator().manual_seed(len(batch) + 2 * n_dashpot)
    factor = draw(*batch, N, N, generator=g)
    stiffness = factor @ factor.mT + 0.5 * torch.eye(N)
    mass = torch.eye(N).double() + 0.1 * (lambda m: m @ m.mT)(draw(N, N, generator=g))
    if repeated:
        # Two eigenvalues are exactly 2.
        mass, stiffness = torch.eye(N).double(), torch.diag(torch.tensor([2.0, 5.0, 2.0]).double())
    loss = [0.1 + 0.2 * torch.rand(batch, generator=g, dtype=torch.float64) for _ in range(4)]
    laplace = torch.complex(torch.tensor([0.1, 0.2]), torch.tensor([0.7, 1.6])).to(torch.complex128)
    own = [0.2 * stiffness.clone()] if hysteretic else []
    dashpot, viscous = draw(n_dashpot, N, generator=g), 0.3 + draw(*batch, n_dashpot, generator=g).abs()
    sides = [draw(*batch, 2, N, generator=g), draw(3, N, generator=g)]
    return [stiffness, mass, dashpot, viscous, *loss, *own, laplace, *sides]


def evaluate(*given: torch.Tensor) -> torch.Tensor:
    stiffness, mass, dashpot, viscous, *loss = given[:8]
    *own, laplace, left, right = given[8:]
    # Finite differences move single entries; only the symmetric part is a stiffness or a mass.
    stiffness, mass = 0.5 * (stiffness + stiffness.mT), 0.5 * (mass + mass.mT)
    hysteretic = 0.5 * (own[0] + own[0].mT) if own else None
    system = System(mass, stiffness, dashpot, viscous, hysteretic, Proportional(*loss))
    modes = frozen_modes(stiffness, mass)
    return differentiable_receptance(modal_impedance(system, modes, laplace), left @ modes.shape, right @ modes.shape)


@pytest.mark.parametrize(
    ("batch", "n_dashpot", "hysteretic", "repeated"),
    [
        ((2,), 2, False, True),
        pytest.param((2,), 2, True, True, marks=pytest.mark.check),
        pytest.param((), 2, False, False, marks=pytest.mark.check),
        ((), 0, False, True),
        ((), 0, True, False),
    ],
)
@pytest.mark.check
def test_every_argument_passes_gradcheck(batch: tuple, n_dashpot: int, hysteretic: bool, repeated: bool) -> None:
    given = problem(batch, n_dashpot=n_dashpot, hysteretic=hysteretic, repeated=repeated)
    given = [part.requires_grad_(part.numel() > 0) for part in given]
    # Central differences of numbers of order one in float64: 1e-12 of the step's square, 1e-10 of rounding.
    assert gradcheck(evaluate, given, eps=1e-6, atol=1e-6, rtol=1e-6, check_forward_ad=True)


@pytest.mark.parametrize("repeated", [False, True], ids=["distinct", "repeated"])
@pytest.mark.parametrize(("n_dashpot", "hysteretic"), [(2, False), (2, True), (0, False)])
@pytest.mark.check
def test_every_argument_passes_a_second_gradcheck(n_dashpot: int, hysteretic: bool, repeated: bool) -> None:
    given = problem((), n_dashpot=n_dashpot, hysteretic=hysteretic, repeated=repeated)
    given = [part.requires_grad_(part.numel() > 0) for part in given]
    # Random projections of the second derivative: rounding over the step, 1e-16 / 1e-6, times entries of order 1e3.
    assert gradgradcheck(evaluate, given, eps=1e-6, atol=1e-5, rtol=1e-5, fast_mode=True)


def test_more_responses_than_references_or_fewer_give_the_same_gradient() -> None:
    given = problem((2,), n_dashpot=2, hysteretic=False, repeated=False)
    found = []
    for turned in (False, True):
        parts = [part.clone().requires_grad_() for part in given]
        value = evaluate(*parts[:-2], parts[-1], parts[-2]).mT if turned else evaluate(*parts)
        found.append(torch.autograd.grad(value.abs().log().sum(), parts))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-10)


def test_each_side_alone_has_the_gradient_it_has_among_all() -> None:
    given = problem((2,), n_dashpot=2, hysteretic=False, repeated=False)
    for sides in (given[-2:], given[:-3:-1]):
        both = [side.clone().requires_grad_() for side in sides]
        expected = torch.autograd.grad(evaluate(*given[:-2], *both).abs().log().sum(), both)
        for position in (0, 1):
            alone = [side.clone().requires_grad_(own == position) for own, side in enumerate(sides)]
            (found,) = torch.autograd.grad(evaluate(*given[:-2], *alone).abs().log().sum(), alone[position])
            # The same numbers on the same way.
            torch.testing.assert_close(found, expected[position], rtol=1e-12, atol=1e-12)


def test_the_adjoint_solves_for_the_shorter_side(monkeypatch: pytest.MonkeyPatch) -> None:
    sound, n_solved = gradient.solve, []

    def solve(impedance: Impedance, weight: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
        n_solved.append(weight.shape[-2])
        return sound(impedance, weight, rows)

    monkeypatch.setattr(gradient, "solve", solve)
    given = problem((2,), n_dashpot=2, hysteretic=True, repeated=False)
    for sides in (given[-2:], given[:-3:-1]):
        stiffness = given[0].clone().requires_grad_()
        evaluate(stiffness, *given[1:-2], *sides).abs().sum().backward()
    # Two responses and three references, or three and two: two columns and two of the adjoint.
    assert n_solved == [4, 4]


def test_vmap_lines_up_batches_of_different_depth() -> None:
    g = torch.Generator().manual_seed(3)
    factor, other = draw(4, 3, N, N, generator=g), draw(4, N, N, generator=g)
    stiffness, mass = factor @ factor.mT, other @ other.mT + torch.eye(N)
    found = torch.func.vmap(frozen_modes)(stiffness, mass)
    turned = torch.func.vmap(frozen_modes, in_dims=(1, None))(stiffness.movedim(0, 1), mass[2])
    for member in range(4):
        expected = frozen_modes(stiffness[member], mass[member])
        # One LAPACK call for each matrix, whatever the batch.
        torch.testing.assert_close(found.eigenvalue[member], expected.eigenvalue, rtol=1e-10, atol=1e-10)
        torch.testing.assert_close(found.shape[member].abs(), expected.shape.abs(), rtol=1e-8, atol=1e-8)
        shared = frozen_modes(stiffness[member], mass[2])
        torch.testing.assert_close(turned.eigenvalue[member], shared.eigenvalue, rtol=1e-10, atol=1e-10)
