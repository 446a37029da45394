"""What the gradient of all parameters costs, in evaluations."""

from typing import Any

import torch

from torchplate.bench.problem import LINES, members, paper_model
from torchplate.bench.timing import interleaved
from torchplate.model import PlateModel, reduce


def gradient(n_repeat: int = 7) -> list[dict[str, Any]]:
    """For each case: seconds of an evaluation, of an evaluation with its gradient, and the backward's share."""
    cases = []
    for n_response, n_reference in ((1, 6), (2, 3), (3, 3)):
        for bent in (False, True):
            model = paper_model(bent=bent, n_reference=n_reference, n_response=n_response)
            found = reduce(model, LINES)
            assert found is not None
            way = "reduced basis" if bent else "shared modes"
            cases += [(way, n_member, n_response, n_reference, found[0]) for n_member in (1, 32)]
    cases.append(("all modes", 8, 1, 6, paper_model()))
    return [_cost(*case, n_repeat) for case in cases]


def _cost(
    way: str, n_member: int, n_response: int, n_reference: int, model: PlateModel, n_repeat: int
) -> dict[str, Any]:
    theta = members(model, n_member)

    def forward() -> None:
        with torch.no_grad():
            model.frf(theta, LINES)

    def both() -> None:
        position = theta.clone().requires_grad_()
        frf = model.frf(position, LINES)
        # The gradient of the FRF's power, given directly: the measure on top is not what is timed.
        torch.autograd.grad(frf, position, frf.detach())

    taken = interleaved({"forward": forward, "both": both}, n_repeat)
    return {
        "way": way,
        "n_member": n_member,
        "frfs": f"{n_response} x {n_reference}",
        "forward_s": taken["forward"],
        "backward_over_forward": taken["both"] / taken["forward"] - 1,
    }
