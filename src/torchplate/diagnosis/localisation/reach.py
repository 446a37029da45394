"""From forces at places of the plate to all channels: what a force there would explain, and of which kind it is.

Whatever stiffness, mass or dashpot is missing at one place g, the FRFs change by

    H_jk − H⁰_jk = −α_jg y α_gk,    y(ω) = z / (1 + z α_gg),    z(ω) = k + iωc − ω²m,

exactly, however large z is (Sherman and Morrison); α are the model's own receptances, which reach places where no
sensor is. So for each place and line the best complex y follows from all channels by least squares, weighed by the
noise, and the place that explains most is where a force is missing: a residual force vector without an expansion
(Link, "Localization of errors in computational models using dynamic test data", EURODYN, 1990; Friswell and
Mottershead, Finite Element Model Updating in Structural Dynamics, 1995, ch. 5). What z does with frequency tells
stiffness, damping and mass apart.
"""

import math
from collections.abc import Sequence
from typing import Final

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.effects import SensorChain
from torchplate.measurement import Measurement
from torchplate.model import DERIVATIVE, PlateModel, laplace_lines, sensor_chain

# Receptances that are held at a time: 64 MiB of them.
AT_ONCE = 2**22
# Turns of the fit of z, which comes to rest by itself: numerics.
N_TURN = 12
# Steps of the search around the best place, relative: numerics of a line search.
POLISH: Final = (0.025, 0.012)
KINDS: Final = {"stiffness": 0, "damping": 1, "mass": 2}
UNIT: Final = {"stiffness": "N/m", "damping": "N s/m", "mass": "kg"}


class Reach:
    """From forces at places to all channels, in standard deviations of the noise."""

    def __init__(self, misfit: Misfit, measurement: Measurement, model: PlateModel, theta: Tensor) -> None:
        self.misfit, self.model, self.theta = misfit, model, theta
        self.frequency = measurement.frequency.to(theta)
        assert model.response is not None
        assert model.reference is not None
        self.response = model.mesh.places(model.response).to(theta)
        self.reference = model.mesh.places(model.reference).to(theta)
        own = self._chain(self.response, self.reference)
        self.s = own.laplace
        # What the chain and the kind make of a receptance, over the noise.
        kind = self.s[:, None, None] ** DERIVATIVE[measurement.kind]
        self.weight = own.factor * kind * misfit.inverse
        self.weighted = self.weight.conj() * misfit.residual
        self.power = self.weight.abs().square()

    def _chain(self, response: Tensor, reference: Tensor) -> SensorChain:
        geometry, value = self.model.plan(self.theta).geometry, self.model.values(self.theta)
        chain = sensor_chain(laplace_lines(self.frequency, 0.0), response, reference)
        for label, effect in self.model.effects.items():
            chain = effect.observe(self.model.mesh, chain, value[label], geometry)
        return chain

    def receptance(
        self, response: Float[Tensor, "n_to 2"], reference: Float[Tensor, "n_from 2"]
    ) -> Complex[Tensor, "n_frequency n_to n_from"]:
        """Between places, the chain's factors taken off."""
        read = self.model.frf(self.theta, self.frequency, response.tolist(), reference.tolist(), "receptance")
        return read / self._chain(response, reference).factor

    def best(self, place: Float[Tensor, "n_place 2"]) -> tuple[Tensor, Tensor]:
        """For each line and place the best y, and the sum of squares Σ|α_jg α_gk|² that weighs it."""
        channels = len(self.response) + len(self.reference)
        n_at_once = max(1, AT_ONCE // (len(self.frequency) * channels))
        parts = [self._best(some) for some in place.split(n_at_once)]
        return torch.cat([y for y, _ in parts], dim=-1), torch.cat([size for _, size in parts], dim=-1)

    def _best(self, place: Float[Tensor, "n_place 2"]) -> tuple[Tensor, Tensor]:
        # Receptances are symmetric: the places as responses serve both ends, in one call.
        ends = self.receptance(place, torch.cat([self.response, self.reference]))
        n = len(self.response)
        left, right = ends[..., :n], ends[..., n:]  # [line, place, channel]
        on_right = torch.einsum("lgk,ljk->lgj", right.conj(), self.weighted)
        product = (left.conj() * on_right).sum(-1)
        size = ((right.abs().square() @ self.power.mT) * left.abs().square()).sum(-1)
        return -product / size.clamp(min=1e-300), size

    def index(self, y: Tensor, size: Tensor) -> Float[Tensor, " n_place"]:
        """Part of the misfit beyond noise explained, less what one free number for each line explains of anything."""
        misfit = self.misfit
        free = misfit.n_frf
        left = misfit.total - (size * y.abs().square()).sum(0)
        return (1 - (left * free / (free - 1) - misfit.noise) / misfit.excess).clamp(0.0, 1.0)

    def kinds(self, place: Float[Tensor, "n_place 2"]) -> list[tuple[dict[str, float], dict[str, float]]]:
        """At each place: what a spring, a dashpot, a mass alone and all three explain, and their sizes."""
        y, size = self.best(place)
        own = self.receptance(place, place).diagonal(dim1=-2, dim2=-1)
        found = []
        for index in range(len(place)):
            parts, values = {}, {}
            for name, power in KINDS.items():
                left, value = self._fitted(y[:, index], size[:, index], own[:, index], [power])
                parts[name], values[name] = self.misfit.part(left), float(value[0])
            left, _ = self._fitted(y[:, index], size[:, index], own[:, index], list(KINDS.values()))
            parts["place"] = max(self.misfit.part(left), *parts.values())
            found.append((parts, values))
        return found

    def polished(self, place: Float[Tensor, " 2"]) -> Float[Tensor, " 2"]:
        """The place nearby at which spring, dashpot and mass together explain most: sharper than a free force."""
        for step in POLISH:
            offset = torch.tensor([-step, 0.0, step]).to(place)
            around = (place + torch.cartesian_prod(offset, offset)).clamp(0.0, 1.0)
            y, size = self.best(around)
            own = self.receptance(around, around).diagonal(dim1=-2, dim2=-1)
            left = [
                self._fitted(y[:, index], size[:, index], own[:, index], list(KINDS.values()))[0]
                for index in range(len(around))
            ]
            place = around[left.index(min(left))]
        return place

    def _fitted(self, y: Tensor, size: Tensor, own: Tensor, powers: Sequence[int]) -> tuple[float, Tensor]:
        """Misfit left by z = Σ value s^power, and the values, from y = z (1 − y α_gg), each turn weighed anew.

        Source: Sanathanan and Koerner, IEEE Transactions on Automatic Control 8 (1963).
        """
        basis = torch.stack([self.s**power for power in powers], dim=-1)
        scale = basis.abs().square().mean(0).sqrt()
        basis = basis / scale
        columns = basis * (1 - y * own)[:, None]
        best, least = basis.real.new_zeros(len(powers)), math.inf
        weight = size.sqrt()
        base = self.misfit.total - float((size * y.abs().square()).sum())
        for turn in range(N_TURN):
            design, target = torch.view_as_real(columns * weight[:, None]), torch.view_as_real(y * weight)
            matrix = design.movedim(-1, 0).flatten(0, 1)
            value = torch.linalg.lstsq(matrix, target.mT.flatten()[:, None], driver="gelsd").solution[:, 0]
            z = basis @ value.to(basis)
            slope = 1 / (1 + z * own)
            left = base + float((size * (y - z * slope).abs().square()).sum())
            if left < least:
                best, least = value, left
            elif turn > 2:
                break
            # y − z (1 − y α) = (y − z / (1 + z α)) (1 + z α).
            weight = size.sqrt() * slope.abs()
        return least, best / scale
