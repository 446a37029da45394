"""A thickness for each element from FRFs: as many unknowns as elements, and one reverse pass for all of them.

A rolled or etched plate is not equally thick everywhere. Sought is log(h/h₀) of all 80 elements, at once, as the
maximum of the posterior

    ½ Σ |H(θ) − measured|² / σ² + ½ Σ over neighbours (θ_a − θ_b)² / s²,

with σ the noise of a line's real and imaginary part and s the change of thickness that is expected between two
neighbouring elements: the smoothness prior, a Gaussian random field without a mean. It is what parts a thickness
map from the many that fit as well, for 80 values see some FRFs only in combination.

L-BFGS goes from the uniform plate through bands that widen: far above the first modes a peak of the start lies nearer
to a wrong peak of the measurement than to its own. Sensors and forces sit off the lines of symmetry, since a field and
its mirror image have the same natural frequencies. The virtual measurement has the mesh of the fit, so that noise and
prior alone set the error; on a real plate the mesh adds its own.

Run: `python -m torchplate.examples.thickness_field [--out FILE.png]`
"""

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from matplotlib.figure import Figure
from torch import Tensor

from torchplate.effects import HystereticDamping, Plate, SupportSpring
from torchplate.model import PlateModel
from torchplate.notation import percent
from torchplate.plate import Mesh, Plan

SENSORS = [(0.04, 0.06), (0.97, 0.13), (0.62, 0.94), (0.31, 0.41), (0.86, 0.71), (0.09, 0.83)]
FORCES = [(0.23, 0.12), (0.71, 0.36)]
# A pair that no fit has seen.
HELD_OUT = [(0.47, 0.77)], [(0.12, 0.58)]
# Expected change of thickness from an element to its neighbour, as a part of it [-].
SMOOTHNESS = 0.02
# Upper ends of the bands [Hz], one stage of the fit each.
BANDS = (90.0, 180.0, 360.0)
SPACING = 3.0


class ThicknessField(PlateModel):
    """A plate whose theta ends with log(h/h₀) of every element, after the searched parameters of its effects.

    The catalogue's effects have single numbers for parameters; a field is one tensor. So the model takes it here, where
    effects have made the section and no matrix is built yet.
    """

    def values(self, theta: Float[Tensor, "*batch n_theta"]) -> dict[str, dict[str, Tensor]]:
        """What the effects read: theta without the field."""
        return super().values(theta[..., : len(self.names)])

    def plan(self, theta: Float[Tensor, "*batch n_theta"]) -> Plan:
        """The effects' section, its thickness times exp(field)."""
        plan = super().plan(theta)
        field = theta[..., len(self.names) :]
        section = plan.section._replace(thickness=plan.section.thickness * field.exp())
        return plan._replace(section=section)


class Found(NamedTuple):
    """What the example has to show; maps are [n_y, n_x], errors parts of the true thickness [-].

    Attributes:
        truth: the true thickness [m].
        thickness: the found one [m].
        error: root mean square error of the found map.
        start_error: of the uniform start.
        best_uniform_error: of the true map's own mean, the best that any uniform plate can do.
        held_out: relative FRF norm on a pair that no fit has seen.
        start_held_out: of the uniform start.
        frf_time: of one FRF without a gradient [s].
        gradient_time: of the objective and its gradient in all elements [s].
    """

    truth: Float[Tensor, "n_y n_x"]
    thickness: Float[Tensor, "n_y n_x"]
    error: float
    start_error: float
    best_uniform_error: float
    held_out: float
    start_held_out: float
    frf_time: float
    gradient_time: float


def plate(n_x: int, n_y: int) -> ThicknessField:
    """A free aluminium plate on three soft wires, 3 mm thick where the field is 0."""
    return ThicknessField(
        Mesh(0.5, 0.4, n_x, n_y),
        {
            "plate": Plate(),
            "wires": SupportSpring(at=((0.1, 0.0), (0.9, 0.0), (0.5, 1.0))),
            "loss": HystereticDamping(),
        },
        known={
            "plate.youngs_modulus": 7e10,
            "plate.poisson_ratio": 0.33,
            "plate.density": 2700.0,
            "plate.thickness": 3e-3,
            "wires.stiffness": 500.0,
            "loss.stiffness_loss_factor": 0.01,
        },
        response=SENSORS,
        reference=FORCES,
        kind="accelerance",
    )


def true_field(mesh: Mesh) -> Float[Tensor, " n_element"]:
    """log(h/h₀) of a plate that tapers, with a shallow dip and a bulge off its middle [-]."""
    x, y = mesh.element_place.unbind(-1)
    dip = torch.exp(-((x - 0.3) ** 2 + (y - 0.65) ** 2) / 0.06)
    bulge = torch.exp(-((x - 0.75) ** 2 + (y - 0.3) ** 2) / 0.05)
    return 0.05 * (x - 0.4) - 0.10 * dip + 0.06 * bulge


def roughness(field: Float[Tensor, " n_element"], mesh: Mesh) -> Float[Tensor, ""]:
    """Σ (θ_a − θ_b)² over neighbouring elements [-]."""
    grid = field.unflatten(-1, mesh.cells[::-1])
    return grid.diff(dim=0).square().sum() + grid.diff(dim=1).square().sum()


def fit(
    model: ThicknessField,
    frequency: Float[Tensor, " n_frequency"],
    measured: Complex[Tensor, "n_frequency n_response n_reference"],
    noise: float,
    bands: Sequence[float],
    n_iteration: int,
    say: Callable[[str], object] = print,
) -> Float[Tensor, " n_element"]:
    """The most probable field: L-BFGS from the uniform plate, band after band.

    Args:
        model: the plate.
        frequency: lines [Hz].
        measured: FRFs at the model's own pairs.
        noise: σ of the real and of the imaginary part.
        bands: upper end of each stage [Hz].
        n_iteration: L-BFGS iterations of a stage, at most.
        say: takes a line for each stage.
    """
    # In units of s the prior is of order one, which is the curvature that L-BFGS begins with.
    free = torch.zeros(model.mesh.n_element, dtype=torch.float64, requires_grad=True)
    for end in bands:
        inside = frequency <= end
        optimizer = torch.optim.LBFGS(
            [free], max_iter=n_iteration, history_size=50, line_search_fn="strong_wolfe", tolerance_change=1e-7
        )

        def objective(lines: Tensor = frequency[inside], target: Tensor = measured[inside]) -> Tensor:
            free.grad = None
            gap = torch.view_as_real(model.frf(SMOOTHNESS * free, lines) - target) / noise
            total = 0.5 * gap.square().sum() + 0.5 * roughness(free, model.mesh)
            total.backward()
            return total

        optimizer.step(objective)
        with torch.no_grad():
            gap = (model.frf(SMOOTHNESS * free, frequency) - measured)[inside].norm() / measured[inside].norm()
        n_line, n_call = int(inside.sum()), optimizer.state[free]["func_evals"]
        say(f"up to {end:.0f} Hz: {n_line} lines, {n_call} gradients, ‖model − measured‖/‖measured‖ {gap:.4f}")
    return (SMOOTHNESS * free).detach()


def draw(truth: Float[Tensor, "n_y n_x"], thickness: Float[Tensor, "n_y n_x"], sides: tuple[float, float]) -> Figure:
    """The true map, the found map, both in mm on one scale, and the error in % of the truth."""
    figure = Figure(figsize=(9, 2.6), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    low, high = 1e3 * float(truth.min()), 1e3 * float(truth.max())
    error = 100 * (thickness / truth - 1)
    ends = float(error.abs().max())
    panels = (
        ("true thickness [mm]", 1e3 * truth, "viridis", low, high),
        ("found thickness [mm]", 1e3 * thickness, "viridis", low, high),
        ("found − true [%]", error, "RdBu_r", -ends, ends),
    )
    for axis, (title, values, colours, bottom, top) in zip(axes, panels, strict=True):
        image = axis.imshow(
            values.numpy(), origin="lower", extent=(0, sides[0], 0, sides[1]), cmap=colours, vmin=bottom, vmax=top
        )
        figure.colorbar(image, ax=axis, shrink=0.8)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("x [m]", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0].set_ylabel("y [m]", fontsize=8)
    for x, y in SENSORS:
        axes[1].plot(x * sides[0], y * sides[1], "k^", markersize=4)
    for x, y in FORCES:
        axes[1].plot(x * sides[0], y * sides[1], "rx", markersize=5)
    return figure


def main(
    n_x: int = 10,
    n_y: int = 8,
    bands: Sequence[float] = BANDS,
    n_iteration: int = 120,
    seed: int = 0,
    out: Path | None = None,
    say: Callable[[str], object] = print,
) -> Found:
    """Make a virtual measurement of a plate with a thickness field, and find the field.

    Args:
        n_x: elements along x.
        n_y: elements along y.
        bands: upper end of each stage of the fit [Hz].
        n_iteration: L-BFGS iterations of a stage, at most.
        seed: of the noise.
        out: where the figure goes; None draws none.
        say: takes each line of the report.
    """
    generator = torch.Generator().manual_seed(seed)
    model = plate(n_x, n_y)
    true = true_field(model.mesh)
    frequency = torch.arange(5.0, bands[-1], SPACING, dtype=torch.float64)
    with torch.no_grad():
        clean = model.frf(true, frequency)
    # 1 % of the FRFs' root mean square, on both parts together.
    noise = 0.01 * float(clean.abs().square().mean().sqrt()) / 2**0.5
    measured = clean + noise * torch.view_as_complex(
        torch.randn(*clean.shape, 2, generator=generator, dtype=torch.float64)
    )
    start = torch.zeros_like(true)
    frf_time, gradient_time = _cost(model, start, frequency, measured)
    say(
        f"one FRF {1e3 * frf_time:.0f} ms, FRF and its gradient in {len(true)} elements {1e3 * gradient_time:.0f} ms: "
        f"{gradient_time / frf_time:.1f} FRFs, where differences take {len(true) + 1}"
    )
    began = time.perf_counter()
    field = fit(model, frequency, measured, noise, bands, n_iteration, say)
    say(f"fit: {time.perf_counter() - began:.0f} s")

    with torch.no_grad():
        unseen = model.frf(torch.stack([true, field, start]), frequency, *HELD_OUT)
    gaps = (unseen[1:] - unseen[0]).flatten(1).norm(dim=-1) / unseen[0].norm()
    thickness, found, uniform = (3e-3 * one.exp().unflatten(-1, (n_y, n_x)) for one in (true, field, start))

    def error(one: Tensor) -> float:
        return float((one / thickness - 1).square().mean().sqrt())

    result = Found(
        thickness,
        found,
        error(found),
        error(uniform),
        error(thickness.mean()),
        float(gaps[0]),
        float(gaps[1]),
        frf_time,
        gradient_time,
    )
    largest = float((found / thickness - 1).abs().max())
    say(
        f"thickness map, r.m.s. error: found {percent(result.error)} (largest {percent(largest)}), uniform start "
        f"{percent(result.start_error)}, best uniform plate {percent(result.best_uniform_error)}"
    )
    say(f"FRF that no fit has seen, relative norm: found {result.held_out:.4f}, start {result.start_held_out:.4f}")
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        draw(thickness, found, (model.mesh.length_x, model.mesh.length_y)).savefig(out, dpi=90)
        say(f"figure: {out}")
    return result


def _cost(model: ThicknessField, field: Tensor, frequency: Tensor, measured: Tensor) -> tuple[float, float]:
    """Seconds for an FRF without a gradient, and for one with it: the shortest of three."""
    taken: list[list[float]] = [[], []]
    for _ in range(3):
        began = time.perf_counter()
        with torch.no_grad():
            model.frf(field, frequency)
        taken[0].append(time.perf_counter() - began)
        wanted = field.clone().requires_grad_()
        began = time.perf_counter()
        (model.frf(wanted, frequency) - measured).abs().square().sum().backward()
        taken[1].append(time.perf_counter() - began)
    return min(taken[0]), min(taken[1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Recover a thickness field from FRFs.")
    parser.add_argument("--out", type=Path, default=Path("runs/thickness_field.png"), help="the figure")
    main(out=parser.parse_args().out)
