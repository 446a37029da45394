"""What may be looked at inside transforms of torch."""

import pytest
import torch

from torchplate.plate.transforms import is_vmapped


# torch compiles rules of its own by a function that it has itself deprecated.
@pytest.mark.filterwarnings("ignore:`torch.jit.script:DeprecationWarning")
def test_values_are_hidden_by_vmap_and_by_no_derivative():
    seen: list[bool] = []

    def look(value: torch.Tensor) -> torch.Tensor:
        seen.append(is_vmapped(1.0, value))
        return value.sum()

    place = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 7.0]])
    look(place)
    torch.func.grad(look)(place)
    torch.func.jvp(look, (place,), (place,))
    assert seen == [False] * 3
    seen.clear()
    torch.func.vmap(look)(place)
    torch.func.vmap(torch.func.grad(look))(place)
    torch.func.grad(lambda all_of_them: torch.func.vmap(look)(all_of_them).sum())(place)
    assert seen == [True] * 3
