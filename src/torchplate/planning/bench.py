"""One hypothesis, in a basis that serves every proposed test: the plate as it was tested, and in any other state."""

from collections.abc import Sequence

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis import ModelBuilder, Rival
from torchplate.discrepancy import specimen_columns
from torchplate.model import PlateModel, Point
from torchplate.planning.proposal import Proposal


class Bench:
    """A hypothesis with its specimen as it was found; the rest of what is not known of either is normal.

    Args:
        builder: of the given model, beside the measured test.
        rival: the hypothesis.
        places: where proposals attach or read something.
    """

    @torch.no_grad()
    def __init__(self, builder: ModelBuilder, rival: Rival, places: Sequence[Point]) -> None:
        self.rival, target = rival, builder.target
        model = rival.model(builder.given)
        theta = model.space.to_si(rival.position)
        wide = builder.corrected(model, theta).model.replaced()
        own, hit = wide.response, wide.reference
        # The basis holds what a force at each of these places does: FRFs from any of them to any other are asked for.
        wide.response, wide.reference = [*(own or ()), *(hit or ()), *places], None
        plain = builder.reduced(wide, theta[None])
        plain.response, plain.reference = own, hit
        self.specimens = target.specimens(plain, theta)
        found = rival.found
        n_off = len(self.specimens.names)
        self.found = None if found is None or not n_off else found.of(n_off).within(target.settings.fitting.farthest)
        self.model = self.specimens.of(self.found)
        self.here = rival.position.clamp(0.0, 1.0)
        self.axes = principal_axes(rival.precision)

    def theta(self, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """Parameters in SI units."""
        return self.model.space.to_si(position)

    @torch.no_grad()
    def specimen_columns(
        self,
        state: PlateModel,
        theta: Float[Tensor, " n"],
        frequency: Float[Tensor, " n_frequency"],
        like: Complex[Tensor, "n_frequency n_response n_reference"],
    ) -> Complex[Tensor, "n_column n_frequency n_response n_reference"]:
        """What is not known of the specimen: changes of the FRFs in a state, by one standard deviation each.

        Args:
            state: the plate in it.
            theta: its parameters.
            frequency: lines [Hz].
            like: FRFs of the same channels.
        """
        if self.found is None:
            return like[None][:0]
        value, vector = torch.linalg.eigh(0.5 * (self.found.spread + self.found.spread.mT))
        root = vector * value.clamp(min=0.0).sqrt()
        columns = specimen_columns(state, theta, frequency, self.specimens)
        return (columns @ root[:, value > 0].to(columns)).movedim(-1, 0)

    def state(self, proposal: Proposal | None) -> PlateModel:
        """The plate in a proposed state; as it was tested, where there is none."""
        return self.model if proposal is None else proposal.state(self.model)

    def in_state(self, state: PlateModel, position: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n_state"]:
        """Parameters of the plate that a state still has."""
        theta = self.theta(position)
        return theta[..., [self.model.names.index(name) for name in state.names]]


def principal_axes(precision: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """Columns by one standard deviation each, independent of each other, of a normal posterior."""
    if not len(precision):
        return precision
    # Parameters that the data know 10⁶ times as well as others are scaled alike first.
    norm = precision.diagonal().rsqrt()
    value, vector = torch.linalg.eigh(norm[:, None] * precision * norm)
    return norm[:, None] * vector * value.clamp(min=1e-14).rsqrt()
