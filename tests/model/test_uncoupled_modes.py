"""Receptances where each mode loses by itself, whatever has a batch of its own."""

import itertools

import pytest
import torch

from torchplate.model.receptance import modal_receptance
from torchplate.model.receptance.modal_receptance import ModalSystem, receptance
from torchplate.plate import Proportional

MEMBER, MODE, LINE, PLACE = 3, 5, 7, 2
PARTS = ("eigenvalue", "dashpot", "force", "loss", "response", "reference")


def drawn(name: str, n_row: int, *batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(PARTS.index(name))
    shape = {"eigenvalue": (MODE,), "loss": (MODE,), "dashpot": (PLACE, MODE), "force": (PLACE, LINE)}
    whole = torch.rand(MEMBER, *shape.get(name, (n_row, MODE)), generator=generator, dtype=torch.float64) + 0.1
    whole = {"eigenvalue": 1e5 * whole, "loss": 1e3 * whole, "force": 1e4 * whole}.get(name, whole)
    return whole.to(torch.complex128) * (1 + 0.2j) if name == "force" else whole


COMMON = Proportional(stiffness_loss_factor=0.01)


def found(parts: dict[str, torch.Tensor], damping: Proportional = COMMON) -> torch.Tensor:
    laplace = 1j * torch.linspace(50.0, 300.0, LINE, dtype=torch.float64)
    system = ModalSystem(
        parts["eigenvalue"], damping, laplace, parts["dashpot"], parts["force"], torch.diag_embed(parts["loss"])
    )
    return receptance(system, parts["response"], parts["reference"])


# As many rows as members, too: what is broadcast wrongly does not say so then.
@pytest.mark.parametrize(("n_response", "n_reference"), [(1, 4), (2, 3), (3, 3), (4, 2), (3, 6), (1, 18), (17, 1)])
@torch.no_grad()
def test_members_are_what_each_is_alone(n_response, n_reference):
    rows = {"response": n_response, "reference": n_reference}
    whole = {name: drawn(name, rows.get(name, 0)) for name in PARTS}
    for own in itertools.chain.from_iterable(itertools.combinations(PARTS, n) for n in (1, 2, len(PARTS))):
        together = found({name: part if name in own else part[0] for name, part in whole.items()})
        for index in range(MEMBER):
            alone = found({name: part[index if name in own else 0] for name, part in whole.items()})
            assert torch.allclose(together[index], alone, rtol=1e-12, atol=1e-15 * float(alone.abs().max())), own


@pytest.mark.parametrize("n_response", [3, 17])
@torch.no_grad()
def test_members_have_the_loss_that_is_proportional_each_its_own(n_response):
    """As many members as parts of a complex number, too, and more."""
    parts = {name: drawn(name, {"response": n_response, "reference": 1}.get(name, 0))[0] for name in PARTS}
    for beta in ([0.01, 0.2], [0.01, 0.2, 0.05]):
        own = torch.tensor(beta, dtype=torch.float64)
        together = found(parts, Proportional(stiffness_loss_factor=own, mass_coefficient=2 * own))
        for one, value in zip(together, own, strict=True):
            alone = found(parts, Proportional(stiffness_loss_factor=value, mass_coefficient=2 * value))
            assert torch.allclose(one, alone, rtol=1e-12, atol=1e-15 * float(alone.abs().max()))


@torch.no_grad()
def test_they_are_the_solutions_of_the_whole_impedance():
    parts = {name: drawn(name, {"response": 2, "reference": 4}.get(name, 0))[0] for name in PARTS}
    s = 1j * torch.linspace(50.0, 300.0, LINE, dtype=torch.float64)
    alone = torch.diag(parts["eigenvalue"] * (1 + 0.01j)) + 1j * torch.diag(parts["loss"])
    u = parts["dashpot"].to(torch.complex128)
    for index, one in enumerate(found(parts)):
        impedance = alone + torch.eye(MODE) * s[index] ** 2 + u.mT @ torch.diag(parts["force"][:, index]) @ u
        solved = parts["response"].to(u) @ torch.linalg.solve(impedance, parts["reference"].to(u).mT)
        assert torch.allclose(one, solved, rtol=1e-10)


@pytest.mark.parametrize(("n_response", "n_reference", "carried"), [(3, 3, False), (1, 4, False), (1, 18, True)])
@torch.no_grad()
def test_rows_are_carried_to_the_modes_where_the_other_side_has_many_more(
    monkeypatch, n_response, n_reference, carried
):
    calls = []
    inner = modal_receptance.pulls
    monkeypatch.setattr(modal_receptance, "pulls", lambda *given: calls.append(1) or inner(*given))
    rows = {"response": n_response, "reference": n_reference}
    found({name: drawn(name, rows.get(name, 0)) for name in PARTS})
    assert bool(calls) == carried
