"""Two channels whose labels are exchanged: cables plugged the wrong way round, a wrong line of the test sheet."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Channel, Check, Effect, SensorChain, Value
from torchplate.plate import Geometry, Mesh


@dataclass(frozen=True)
class ChannelSwap(Effect):
    """What is read under the label of the one is the FRF of the other, and the other way round.

    Args:
        channels: the two, both FRFs [response, reference], both whole responses or both whole references; node labels
            or relative places, null for all of a side, one node label as in `channel_polarity`.

    Raises:
        ValueError: if they are not two of a kind, or later if a label is not on the grid, or only one of the two is
            among the FRFs asked for.
    """

    channels: Sequence[Channel] = ()

    parameters = {}
    check = Check(2, "tap beside each sensor and see which channel answers")
    acts_on = frozenset({"sensor chain"})
    shows = "Two FRFs fit each other's place, antiresonances and all, and reciprocity fails for them alone."
    source = "Ewins, Modal Testing (2000), on reciprocity as a check of measured data"

    def __post_init__(self) -> None:
        if len(self.channels) != 2:
            raise ValueError(
                f"Expected channel_swap to name two channels, got {len(self.channels)}. Give two; more exchanged pairs "
                "are more effects."
            )

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """Each reading comes from the other's place, with all that its chain does to it."""
        shape = chain.factor.shape[-2:]
        first, second = (chain.in_channel(mesh, channel).flatten().nonzero().flatten() for channel in self.channels)
        if len(first) == len(second) == 0:
            return chain
        if len(first) != len(second) or bool(torch.isin(first, second).any()):
            raise ValueError(
                f"Expected two channels of one kind for channel_swap, both among the FRFs asked for, got "
                f"{list(self.channels)}, which name {len(first)} and {len(second)} of them. Name two others, or ask "
                "for both."
            )
        source = torch.arange(shape.numel(), device=first.device)
        source[first], source[second] = second, first
        reading = source if chain.reading is None else chain.reading.flatten()[source]
        factor = chain.factor.flatten(-2)[..., source].unflatten(-1, shape)
        return chain._replace(reading=reading.unflatten(0, shape), factor=factor)
