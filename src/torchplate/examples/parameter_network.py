"""A network from an FRF to the plate's parameters, trained through the FRF itself.

The usual way trains on labels: the mean squared error of the parameters, each in units of its interval. That loss does
not know that 1 % of Young's modulus moves a sharp peak off itself while 10 % of a wire hardly shows. Here the predicted
parameters go on through the differentiable FRF, and the loss is how badly they reproduce what was measured,

    ‖H(θ̂) − measured‖ / ‖measured‖,   the mean over the plates (seed paper, Eq. 22),

which asks for no label at all: any plate that was measured is training data, its parameters unknown.

All ways share the network's size, its start, the noisy measurements and the order of the batches; they differ in the
loss. A step through the FRF costs more than a step on labels, so labels also get five times the steps. Compared are
plates that no training has seen: the FRF gap to the noiseless truth, and the error of each parameter. The measurements
are virtual, made by the model that is trained through.

Run: `python -m torchplate.examples.parameter_network`
"""

import itertools
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel, Searched, reduce
from torchplate.plate import Mesh

FREQUENCY = torch.linspace(6.0, 250.0, 62, dtype=torch.float64)
# Of an FRF line, as a part of the plate's root mean square amplitude [-].
NOISE = 0.02
N_HELD_OUT = 200
N_HIDDEN = 64
N_BATCH = 32
LEARNING_RATE = 3e-3


class Plates(NamedTuple):
    """Virtual plates.

    Attributes:
        position: their parameters on the unit cube [-]: the labels.
        clean: their FRFs [m/(N s²)].
        measured: the same with noise: all that a network gets to see.
    """

    position: Float[Tensor, "n_plate n_parameter"]
    clean: Complex[Tensor, "n_plate n_frequency n_response 1"]
    measured: Complex[Tensor, "n_plate n_frequency n_response 1"]

    def at(self, index: Tensor | slice) -> "Plates":
        """Some of them."""
        return Plates(*(part[index] for part in self))


class Way(NamedTuple):
    """A way to train.

    Attributes:
        labels: weight of the mean squared error of the parameters.
        frf: weight of the relative FRF norm.
        n_times: how many times the steps.
        n_label: it trains only on the first so many plates; 0 for all.
    """

    labels: float
    frf: float
    n_times: int = 1
    n_label: int = 0


WAYS = {
    "parameters": Way(1.0, 0.0),
    "parameters, five times the steps": Way(1.0, 0.0, n_times=5),
    "parameters, only 50 plates labelled": Way(1.0, 0.0, n_label=50),
    "FRF, no labels": Way(0.0, 1.0),
    # At the end of training 10 × the parameters' part is about a tenth of the FRF's.
    "FRF and parameters": Way(10.0, 1.0),
}


class Score(NamedTuple):
    """Of one network, on plates that it was not trained on.

    Attributes:
        gap: mean relative norm of the FRF's error against the noiseless FRF [-].
        error: root mean square error of each parameter, as a part of its interval [-].
        seconds: what the training took [s].
    """

    gap: float
    error: Float[Tensor, " n_parameter"]
    seconds: float


def plate() -> PlateModel:
    """A free aluminium plate on three wires, in a reduced basis: the same FRFs at a fraction of the cost.

    Raises:
        RuntimeError: if no small basis holds over the whole box.
    """
    model = PlateModel(
        Mesh(0.6, 0.4, 6, 5),
        {
            "plate": Plate(),
            "wires": SupportSpring(at=((0.1, 0.0), (0.9, 0.0), (0.5, 1.0))),
            "loss": HystereticDamping(),
        },
        known={"plate.density": 2700.0, "plate.thickness": 3e-3, "plate.poisson_ratio": 0.33},
        searched={
            "plate.youngs_modulus": Searched(6e10, 8e10),
            "wires.stiffness": Searched(2e3, 2e4, logarithmic=True),
            "loss.stiffness_loss_factor": Searched(1e-2, 4e-2, logarithmic=True),
        },
        response=[(0.05, 0.1), (0.83, 0.62)],
        reference=[(0.37, 0.28)],
        kind="accelerance",
    )
    small = reduce(model, FREQUENCY)
    if small is None:
        raise RuntimeError("Expected a reduced basis for the whole box, got none. Narrow the box or the band.")
    return small[0]


def measure(model: PlateModel, n_plate: int, generator: torch.Generator) -> Plates:
    """Plates drawn evenly from the box of the parameters, each measured once with noise."""
    position = torch.rand(n_plate, len(model.names), generator=generator, dtype=torch.float64)
    with torch.no_grad():
        clean = model.frf(model.space.to_si(position), FREQUENCY)
    level = NOISE * clean.abs().square().mean((1, 2, 3), keepdim=True).sqrt() / 2**0.5
    parts = torch.randn(*clean.shape, 2, generator=generator, dtype=torch.float64)
    return Plates(position, clean, clean + level * torch.view_as_complex(parts))


class ParameterNetwork(nn.Module):
    """From log amplitudes, each line standardised over the training plates, to the unit cube of the parameters.

    Args:
        measured: FRFs of the training plates.
        n_parameter: number of parameters.
        generator: draws the weights.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(
        self,
        measured: Complex[Tensor, "n_plate n_frequency n_response 1"],
        n_parameter: int,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        feature = measured.abs().log().flatten(1)
        self.register_buffer("mean", feature.mean(0))
        self.register_buffer("deviation", feature.std(0))
        widths = [feature.shape[1], N_HIDDEN, N_HIDDEN, n_parameter]
        layers: list[nn.Module] = []
        for n_in, n_out in itertools.pairwise(widths):
            # torch's own initialisation would draw from the global generator.
            layer = nn.utils.skip_init(nn.Linear, n_in, n_out, dtype=torch.float64)
            nn.init.xavier_uniform_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)
            layers += [layer, nn.Tanh()]
        self.layers = nn.Sequential(*layers[:-1], nn.Sigmoid())

    def forward(
        self, measured: Complex[Tensor, "n_plate n_frequency n_response 1"]
    ) -> Float[Tensor, "n_plate n_parameter"]:
        """Parameters on the unit cube."""
        return self.layers((measured.abs().log().flatten(1) - self.mean) / self.deviation)


def frf_gap(
    model: PlateModel,
    position: Float[Tensor, "n_plate n_parameter"],
    expected: Complex[Tensor, "n_plate n_frequency n_response 1"],
) -> Float[Tensor, ""]:
    """‖H(θ) − expected‖ / ‖expected‖ of each FRF, the mean over FRFs and plates [-]."""
    found = model.frf(model.space.to_si(position), FREQUENCY)
    return ((found - expected).norm(dim=1) / expected.norm(dim=1)).mean()


def train(model: PlateModel, plates: Plates, way: Way, n_step: int, seed: int) -> ParameterNetwork:
    """One network by Adam; networks of one seed have one start and see the same batches.

    Args:
        model: the plate.
        plates: the training plates.
        way: the loss.
        n_step: number of batches, where the way has no more.
        seed: of the weights and the batches.
    """
    generator = torch.Generator().manual_seed(seed)
    network = ParameterNetwork(plates.measured, len(model.names), generator)
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE, fused=True)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, way.n_times * n_step)
    for _ in range(way.n_times * n_step):
        batch = plates.at(torch.randint(way.n_label or len(plates.position), (N_BATCH,), generator=generator))
        position = network(batch.measured)
        loss = position.new_zeros(())
        if way.labels:
            loss = loss + way.labels * (position - batch.position).square().mean()
        if way.frf:
            loss = loss + way.frf * frf_gap(model, position, batch.measured)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
    return network


@torch.no_grad()
def score(model: PlateModel, network: ParameterNetwork, plates: Plates, seconds: float = 0.0) -> Score:
    """How good a network is on plates that it has not seen."""
    position = network(plates.measured)
    error = (position - plates.position).square().mean(0).sqrt()
    return Score(float(frf_gap(model, position, plates.clean)), error, seconds)


def main(
    n_plate: int = 400,
    n_step: int = 600,
    seeds: Sequence[int] = (0, 1, 2),
    ways: Sequence[str] = tuple(WAYS),
    say: Callable[[str], object] = print,
) -> dict[str, list[Score]]:
    """Train one network for each way and seed, and score all on plates that none has seen.

    Args:
        n_plate: plates to train on.
        n_step: steps of a training.
        seeds: each draws its own plates, noise, weights and batches.
        ways: keys of `WAYS`.
        say: takes each line of the report.

    Returns:
        Way → a score for each seed.
    """
    model = plate()
    result: dict[str, list[Score]] = {way: [] for way in ways}
    for seed in seeds:
        plates = measure(model, n_plate + N_HELD_OUT, torch.Generator().manual_seed(1000 + seed))
        for way in ways:
            began = time.perf_counter()
            network = train(model, plates.at(slice(n_plate)), WAYS[way], n_step, seed)
            seconds = time.perf_counter() - began
            result[way].append(score(model, network, plates.at(slice(n_plate, None)), seconds))
    say(f"{n_plate} plates, {n_step} steps, seeds {', '.join(map(str, seeds))}; scores on {N_HELD_OUT} other plates")
    names = [name.split(".")[1] for name in model.names]
    say(f"{'trained on':36} {'FRF gap, seed by seed':24} {'r.m.s. error in % of the interval: ' + ', '.join(names)}")
    for way, scores in result.items():
        gaps = " ".join(f"{one.gap:.3f}" for one in scores)
        error = 100 * torch.stack([one.error for one in scores]).mean(0)
        seconds = sum(one.seconds for one in scores) / len(scores)
        say(f"{way:36} {gaps:24} {' '.join(f'{value:6.2f}' for value in error.tolist())}   ({seconds:.1f} s each)")
    return result


if __name__ == "__main__":
    main()
