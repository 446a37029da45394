"""FRFs that an effect only exchanges or turns: nothing has to be solved for them."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.effects import Effect
from torchplate.model.receptance.frf import sensor_chain
from torchplate.plate import Geometry, Mesh


def rearranged(
    frf: Complex[Tensor, "*batch n_frequency n_response n_reference"],
    effect: Effect,
    mesh: Mesh,
    geometry: Geometry,
    response: Float[Tensor, "n_response 2"],
    reference: Float[Tensor, "n_reference 2"] | None,
) -> Complex[Tensor, "*batch n_frequency n_response n_reference"] | None:
    """FRFs as one more effect of the sensor chain reports them; None for an effect that does more than rearrange.

    Args:
        frf: without it.
        effect: the last of the chain.
        mesh: of the model.
        geometry: likewise.
        response: relative places.
        reference: likewise; None where the base moves.
    """
    if effect.acts_on != {"sensor chain"} or effect.parameters:
        return None
    laplace = torch.zeros(frf.shape[-3], dtype=frf.dtype, device=frf.device)
    plain = sensor_chain(laplace, response, reference)
    chain = effect.observe(mesh, plain, {}, geometry)
    if chain.laplace is not plain.laplace or chain.response is not plain.response:
        return None
    if chain.reading is not None:
        frf = frf.flatten(-2)[..., chain.reading]
    return chain.factor * frf
