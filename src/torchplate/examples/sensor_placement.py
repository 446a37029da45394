"""Where to put sensors so that the parameters are found best: D-optimal places by gradient through the FRF.

The residuals' derivative J = ∂H/∂θ comes by forward mode, one tangent for each parameter; the Fisher information of
noise N(0, σ² R) is

    F = Jᵀ R⁻¹ J / σ²,    standard errors √diag F⁻¹ (the Cramér–Rao bound),

and log det F goes back in reverse mode to the places (x, y), which are continuous: the shape functions read the plate
between its nodes as well. Many starts share one FRF, whose responses are the sensors of all of them.

Noise of sensors closer than `LENGTH` is half shared. With independent noise the optimum puts several sensors on one
spot, where the second is no more than a repetition of the first.

Sources: D-optimality: Fedorov, Theory of Optimal Experiments (1972). Effective independence: Kammer, J. Guidance,
Control, and Dynamics 14 (1991) 251. Correlated noise: Papadimitriou and Lombaert, Mechanical Systems and Signal
Processing 28 (2012) 105.

Run: `python -m torchplate.examples.sensor_placement`
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchplate.effects import HystereticDamping, Plate, PointMass
from torchplate.model import PlateModel, Searched
from torchplate.plate import Mesh
from torchplate.search import JACOBIANS, least_squares

FORCE = [(0.37, 0.28)]
CORNERS = torch.tensor([(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)], dtype=torch.float64)
# Of the real and of the imaginary part of an accelerance line [m/(N s²)].
NOISE = 0.3
# Correlation length of the noise, relative to the sides [-].
LENGTH = 0.1
FREQUENCY = torch.linspace(20.0, 500.0, 97, dtype=torch.float64)


class Layout(NamedTuple):
    """Sensor places and what they promise.

    Attributes:
        places: (x/Lx, y/Ly) [-].
        log_det: log det F over the unit cube of the parameters.
        standard_error: of each parameter, as a part of its interval [-].
    """

    places: Float[Tensor, "n_sensor 2"]
    log_det: float
    standard_error: Float[Tensor, " n_parameter"]


def plate(n_x: int = 6, n_y: int = 5) -> PlateModel:
    """An aluminium plate held at its edges, with a mass of unknown size at an unknown place."""
    edges = {"x0": "clamped", "x1": "simply_supported", "y0": "simply_supported", "y1": "simply_supported"}
    return PlateModel(
        Mesh(0.6, 0.4, n_x, n_y, edges=edges),
        {"plate": Plate(), "loss": HystereticDamping(), "mass": PointMass()},
        known={"plate.density": 2700.0, "plate.poisson_ratio": 0.33},
        searched={
            "plate.youngs_modulus": Searched(6e10, 8e10),
            "plate.thickness": Searched(2.7e-3, 3.3e-3),
            "loss.stiffness_loss_factor": Searched(5e-3, 2e-2),
            "mass.x": Searched(0.55, 0.75),
            "mass.y": Searched(0.5, 0.8),
            "mass.mass": Searched(0.01, 0.09),
        },
        kind="accelerance",
    )


def readings(
    model: PlateModel, position: Float[Tensor, "*batch n_parameter"], places: Float[Tensor, "n_sensor 2"]
) -> Float[Tensor, "*batch n_sensor n_reading"]:
    """Real and imaginary parts of every sensor's FRF over the noise [-]; `places` is a tensor and has a gradient."""
    whole = model.frf(model.space.to_si(position), FREQUENCY, response=places, reference=FORCE)
    return torch.view_as_real(whole[..., 0].mT / NOISE).flatten(-2)


def correlation(places: Float[Tensor, "*batch n_sensor 2"]) -> Float[Tensor, "*batch n_sensor n_sensor"]:
    """R of the sensors' noise: ½ of their own, ½ shared over the distance d as exp(−d² / 2ℓ²) [-]."""
    square = (places[..., :, None, :] - places[..., None, :, :]).square().sum(-1)
    return 0.5 * torch.eye(places.shape[-2]).to(places) + 0.5 * torch.exp(-0.5 * square / LENGTH**2)


def jacobian(
    model: PlateModel, position: Float[Tensor, " n_parameter"], places: Float[Tensor, "n_sensor 2"]
) -> Float[Tensor, "n_sensor n_reading n_parameter"]:
    """∂ readings / ∂ position, one forward-mode tangent for each parameter; differentiable in the places."""

    def flat(at: Tensor) -> Tensor:
        return readings(model, at, places).flatten(-2)

    return JACOBIANS["autograd"].differentiate(flat, position, flat(position)).unflatten(0, (len(places), -1))


def information(
    slope: Float[Tensor, "*batch n_sensor n_reading n_parameter"], places: Float[Tensor, "*batch n_sensor 2"]
) -> Float[Tensor, "*batch n_parameter n_parameter"]:
    """Fisher information F = Jᵀ R⁻¹ J of the sensors together, the noise in units of σ."""
    white = torch.linalg.solve_triangular(torch.linalg.cholesky(correlation(places)), slope.flatten(-2), upper=False)
    rows = white.unflatten(-1, slope.shape[-2:]).flatten(-3, -2)
    return rows.mT @ rows


def log_det(matrix: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch"]:
    """Logarithm of det F: −2 × the log volume of the parameters' confidence ellipsoid, up to a constant."""
    return torch.linalg.slogdet(matrix).logabsdet


def layout(model: PlateModel, position: Float[Tensor, " n_parameter"], places: Float[Tensor, "n_sensor 2"]) -> Layout:
    """What given places promise."""
    with torch.no_grad():
        matrix = information(jacobian(model, position, places), places)
    return Layout(places, float(log_det(matrix)), torch.linalg.inv(matrix).diagonal().sqrt())


def by_gradient(
    model: PlateModel,
    position: Float[Tensor, " n_parameter"],
    starts: Float[Tensor, "n_start n_sensor 2"],
    n_step: int,
) -> Float[Tensor, "n_sensor 2"]:
    """The best of several ascents of log det F by Adam.

    Args:
        model: the plate.
        position: parameters for which the places are to be good, on the unit cube.
        starts: sensor places, inside the plate [-].
        n_step: steps of each start.
    """
    # A logistic coordinate keeps every sensor on the plate.
    free = starts.logit().requires_grad_()
    optimizer = torch.optim.Adam([free], lr=0.1)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, n_step)
    for _ in range(n_step):
        places = free.sigmoid()
        slope = jacobian(model, position, places.flatten(0, 1)).unflatten(0, places.shape[:2])
        optimizer.zero_grad()
        (-log_det(information(slope, places)).sum()).backward()
        optimizer.step()
        decay.step()
    places = free.detach().sigmoid()
    return max(places, key=lambda one: layout(model, position, one).log_det)


def by_greed(model: PlateModel, position: Float[Tensor, " n_parameter"], n_sensor: int) -> Float[Tensor, "n_sensor 2"]:
    """One sensor after the other, each at the node where log det F grows most."""
    nodes, slope = _candidates(model, position)
    chosen: list[int] = []
    for _ in range(n_sensor):
        left = [index for index in range(len(nodes)) if index not in chosen]
        chosen.append(_best(nodes, slope, [[*chosen, index] for index in left])[-1])
    return nodes[chosen]


def by_effective_independence(
    model: PlateModel, position: Float[Tensor, " n_parameter"], n_sensor: int
) -> Float[Tensor, "n_sensor 2"]:
    """Kammer's way: from all nodes, drop again and again the one that log det F misses least."""
    nodes, slope = _candidates(model, position)
    kept = list(range(len(nodes)))
    while len(kept) > n_sensor:
        kept = _best(nodes, slope, [[other for other in kept if other != index] for index in kept])
    return nodes[kept]


def _candidates(model: PlateModel, position: Tensor) -> tuple[Tensor, Tensor]:
    """Nodes that move, and their J."""
    inside = ((model.mesh.node_place > 0) & (model.mesh.node_place < 1)).all(-1)
    nodes = model.mesh.node_place[inside]
    with torch.no_grad():
        return nodes, jacobian(model, position, nodes)


def _best(nodes: Tensor, slope: Tensor, groups: list[list[int]]) -> list[int]:
    """The group of nodes with the largest log det F."""
    # JᵢᵀJⱼ of all pairs once: a group then costs no sum over lines.
    pairs = torch.einsum("irp,jrq->ijpq", slope, slope)
    index = torch.tensor(groups)
    weight = torch.linalg.inv(correlation(nodes[index]))
    matrix = torch.einsum("gij,gijpq->gpq", weight, pairs[index[:, :, None], index[:, None, :]])
    return groups[int(log_det(matrix).argmax())]


def monte_carlo(
    model: PlateModel,
    position: Float[Tensor, " n_parameter"],
    places: Float[Tensor, "n_sensor 2"],
    n_test: int,
    generator: torch.Generator,
) -> Float[Tensor, " n_parameter"]:
    """Scatter of the parameters over virtual tests that are each fitted, as a part of the interval [-].

    Args:
        model: the plate.
        position: the truth, on the unit cube.
        places: where the sensors are.
        n_test: number of tests; their scatter is known to 1 / √(2 (n − 1)).
        generator: draws the noise.
    """
    root = torch.linalg.cholesky(correlation(places))

    def white(value: Tensor) -> Tensor:
        return torch.linalg.solve_triangular(root, value, upper=False).flatten(-2)

    clean = readings(model, position, places)
    noise = torch.randn(n_test, *clean.shape, generator=generator, dtype=clean.dtype)
    measured = white(clean + root @ noise)
    fit = least_squares(
        lambda at: white(readings(model, at, places)) - measured,
        torch.full((n_test, len(position)), 0.5, dtype=torch.float64),
        jacobian="autograd",
        # Half the sum of 776 squares is 400: what is left to fall moves no parameter by 3 % of its standard error.
        objective_tolerance=1e-6,
        shared=False,
    )
    return fit.position.std(0)


def main(
    n_sensor: int = 4,
    n_random: int = 200,
    n_start: int = 8,
    n_step: int = 60,
    n_test: int = 50,
    cells: tuple[int, int] = (6, 5),
    seed: int = 0,
    say: Callable[[str], object] = print,
) -> dict[str, tuple[Layout, Tensor | None]]:
    """Place the sensors by gradient and otherwise, and let virtual tests check the promised standard errors.

    Args:
        n_sensor: number of sensors.
        n_random: random layouts to compare with; the best of them are the starts of the gradient.
        n_start: number of starts.
        n_step: steps of each start.
        n_test: virtual tests of a layout; 0 leaves them out.
        cells: elements along x and y.
        seed: of places and noise.
        say: takes each line of the report.

    Returns:
        Name → the layout, and the scatter over virtual tests where it was measured.
    """
    began, generator = time.perf_counter(), torch.Generator().manual_seed(seed)
    model = plate(*cells)
    # Off the middle of the box, where the fits start.
    truth = torch.tensor([0.45, 0.6, 0.4, 0.55, 0.4, 0.6], dtype=torch.float64)
    places = torch.rand(n_random, n_sensor, 2, generator=generator, dtype=torch.float64)
    with torch.no_grad():
        slope = jacobian(model, truth, places.flatten(0, 1)).unflatten(0, places.shape[:2])
    rank = log_det(information(slope, places)).argsort(descending=True)
    found = {
        "corners, 10 % inside": CORNERS[:n_sensor],
        f"median of {n_random} random": places[rank[n_random // 2]],
        f"best of {n_random} random": places[rank[0]],
        "greedy over the nodes": by_greed(model, truth, n_sensor),
        "effective independence": by_effective_independence(model, truth, n_sensor),
        "gradient": by_gradient(model, truth, places[rank[:n_start]], n_step),
    }
    names = [name.split(".")[-1] for name in model.names]
    say(f"{'standard error in % of the value':34} {'log det':>8} " + " ".join(f"{name[:14]:>14}" for name in names))
    value = model.space.to_si(truth)
    percent = 100 * (model.space.high - model.space.low) / value
    result: dict[str, tuple[Layout, Tensor | None]] = {}
    for name, chosen in found.items():
        one, scatter = layout(model, truth, chosen), None
        say(f"{name:34} {one.log_det:8.2f} " + " ".join(f"{x:14.4f}" for x in (one.standard_error * percent).tolist()))
        if n_test and name.startswith(("corners", "gradient")):
            scatter = monte_carlo(model, truth, chosen, n_test, generator)
            heading = f"  scatter of {n_test} fitted tests"
            say(f"{heading:34} {'':8} " + " ".join(f"{x:14.4f}" for x in (scatter * percent).tolist()))
        result[name] = one, scatter
    say("places by gradient: " + ", ".join(f"({x:.3f}, {y:.3f})" for x, y in found["gradient"].tolist()))
    say(f"{time.perf_counter() - began:.0f} s")
    return result


if __name__ == "__main__":
    main()
