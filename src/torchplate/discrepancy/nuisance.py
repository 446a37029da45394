"""What every test has and nobody wants named: how each of it, one standard deviation large, changes the FRFs.

With the model's modes Φ, λ at hand, α = L Z⁻¹ Rᵀ changes by dα = dL X_R + X_L dR − X_L dZ X_R to first order, where
X = row Z⁻¹ are the modal responses, with what is attached at places and couples the modes: where a peak stands a
hundred times above the noise, a column that is off by a per cent does not hide what it stands for. What the second
order would add stands beside the noise, that coupling left out: for a mode that moves by q of its own width,
q² / (1 + q) of what the mode contributes to an FRF.

Sources: Adelman and Haftka, AIAA J. 24 (1986) 823, for the derivative of a resolvent; Pintelon and Schoukens, System
Identification (2012), for what an analyser, its transducers and their mounting add.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.discrepancy.drive_point import drive_points
from torchplate.discrepancy.modal_change import (
    Modal,
    as_modes_move,
    by_modes,
    from_responses,
    of_modes,
    through_each,
    to_references,
)
from torchplate.discrepancy.places import carried_off, places_again, supports_off
from torchplate.discrepancy.second_order import SecondOrder
from torchplate.discrepancy.specimen import Found, Specimens
from torchplate.discrepancy.wandering import Elements, Wandering, terms
from torchplate.effects import SensorChain
from torchplate.measurement import Imperfections
from torchplate.model import PlateModel, as_kind, laplace_lines, solve_modes
from torchplate.plate import Plan

# The group of what nobody knows anything of, whose size is not judged: a level without a unit.
FREE = "level"
# Numbers that are laid out at a time: 1 MiB of them.
AT_ONCE = 2**17
# Times the end of the band. A little above it a mode's own peak still reaches into the band, and where it lies is seen.
NEAR = 1.1
# What damps a mode is seen further away. Of a loss factor η that is off by a part σ, the mode's share of the imaginary
# part at ω is σ η / (1 − (ω/ω_r)²)² of its static share: 25 times that at the end of the band for one at 1.1 times its
# frequency, 1.8 times for one at twice. From there on it no longer grows within the band, and all modes beyond, which
# scatter each by itself, add up to less than the first of them.
DAMPED = 2.0


class Nuisances(NamedTuple):
    """Changes of the FRFs by one standard deviation each, and what the second order adds.

    The changes are real and imaginary parts, as they are multiplied with: no second copy of them is needed.

    Attributes:
        common: of what all FRFs share.
        by_response: of what each response has of its own.
        by_reference: of what each reference has of its own.
        group: names of the groups of each column of the three.
        second_order: what the first order leaves out.
        n_off: the first of the common ones, of what a specimen has of its own: its section, and its modes' damping.
        about: the specimen that they are taken about; None for none.
        of_response: what the columns of each response are: "x", "y", "level", "drift".
        of_reference: likewise.
        level: one standard deviation of a level [-].
        drift: of a record's frequencies [-].
        carried: responses whose mass moves with them, which all FRFs feel: where each of their places begins among the
            common ones.
        support: of each place of a support, which of the common ones it is along each side.
        of_support: one standard deviation of that, relative to the sides [-].
    """

    common: Float[Tensor, "n_frequency n_response n_reference 2 n_common"]
    by_response: Float[Tensor, "n_frequency n_response n_reference 2 n_own"]
    by_reference: Float[Tensor, "n_frequency n_response n_reference 2 n_other"]
    group: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]
    second_order: SecondOrder
    n_off: int = 0
    about: Found | None = None
    of_response: tuple[str, ...] = ()
    of_reference: tuple[str, ...] = ()
    level: float = 0.0
    drift: float = 0.0
    carried: Mapping[int, int] = MappingProxyType({})
    support: tuple[tuple[int, int], ...] = ()
    of_support: tuple[float, float] = (0.0, 0.0)


@torch.no_grad()
def nuisances(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    frequency: Float[Tensor, " n_frequency"],
    imperfections: Imperfections,
    wandering: Wandering,
    mesh_shift: Float[Tensor, " n_frequency"],
    about: Found | None = None,
    mesh: tuple[float, float] = (0.0, 0.0),
    drifting: Complex[Tensor, "n_frequency n_response n_reference"] | None = None,
) -> Nuisances:
    """The nuisances of one test of one plate.

    Args:
        model: in a basis of its modes; its responses, references and kind are the measurement's.
        theta: its searched parameters.
        frequency: lines [Hz].
        imperfections: of the test.
        wandering: of the plate.
        mesh_shift: relative error that the mesh leaves of a natural frequency near each line [-].
        about: how far off the specimen is that the model is; None where it is none.
        mesh: what the mesh leaves of the deflections: distance by which lines of equal deflection are off [m], and part
            of them [-].
        drifting: change of the FRFs with a drift of their records, as what was measured says where drifts are taken off
            that; None where the model says it.
    """
    plan, reference, modal, to_reading = _apart(model, theta, frequency)
    chain, kind = to_reading.chain, to_reading.kind
    reading = as_kind(to_references(modal, modal.left), chain, kind)
    n_response, n_reference = reading.shape[-2:]
    top = _top(frequency, NEAR)
    near = torch.nonzero(modal.eigenvalue < top).flatten()
    elastic = near[modal.eigenvalue[near] > 1e-6 * top]

    common: list[tuple[str, Tensor]] = []
    every = terms(model, plan, wandering)
    nothing = modal.shape.new_zeros(0, len(modal.eigenvalue), len(modal.eigenvalue))
    stiffness, mass = nothing, nothing
    if every:
        elements = Elements(model, plan, modal.shape)
        pairs = [(elements.stiffness(one.stiffness, one.coefficient), elements.mass(one.mass)) for one in every]
        stiffness, mass = (torch.stack(part) for part in zip(*pairs, strict=True))
    felt = to_reading(through_each(modal, stiffness, mass, chain.laplace))
    common += [(one.name, change) for one, change in zip(every, felt, strict=True)]
    damped = imperfections.std("damping_scatter")
    if damped > 0:
        n_damped = int((modal.eigenvalue < _top(frequency, DAMPED)).sum())
        common += [("damping_scatter", change) for change in to_reading(_damped(modal, n_damped, damped))]
    n_off = len(common)
    about = None if about is None else about.of(n_off)
    at = torch.searchsorted(
        frequency.to(theta).contiguous(), modal.eigenvalue[elastic].clamp(min=0).sqrt() / (2 * math.pi)
    )
    shift = mesh_shift.to(theta)[at.clamp(max=len(frequency) - 1)]
    off_mesh = elastic[shift > 0]
    moved = 2 * shift[shift > 0] * modal.eigenvalue[off_mesh] * modal.kappa[:, off_mesh]
    common += [("mesh", change) for change in to_reading(of_modes(modal, off_mesh, moved))]
    off = imperfections.std("position_std")
    sides = float(plan.geometry.length_x.mean()), float(plan.geometry.length_y.mean())
    of_support = (off / sides[0], off / sides[1])
    begin = len(common)
    if off > 0:
        hung = supports_off(model, modal, chain.laplace, of_support, theta)
        common += [("position_std", to_reading(change)) for change in hung]
    support = tuple((at, at + 1) for at in range(begin, len(common), 2))

    marks = model._points(None, None, None)[:2]
    if reference is not None and marks[1] is not None:
        for less in drive_points(plan, marks[0].to(modal.left), marks[1].to(modal.left), off):
            common.append(("drive_point", to_reading(less.expand(len(frequency), -1, -1).to(reading))))

    own: list[tuple[str, Tensor]] = []
    other: list[tuple[str, Tensor]] = []
    # Where places are known well, the mesh decides how well.
    far = place_std(imperfections, mesh)
    group = "position_std" if off > mesh[0] else "mesh"
    of_response: list[str] = ["x", "y"] if far > 0 else []
    of_reference: list[str] = ["x", "y"] if far > 0 and reference is not None else []
    carried: dict[int, int] = {}
    # Under which label the response is read that carries it.
    label = model.read_from()[0].argsort().tolist()
    weighs = {label[at]: change for at, change in carried_off(model, modal, chain, theta).items()} if far > 0 else {}
    for side, order in zip(sides, ((1, 0), (0, 1)), strict=True) if far > 0 else ():
        rows = model.assembly.rows(model.mesh.deflection_at(chain.response, *order)) @ modal.shape
        of_row = to_reading(far / side * to_references(modal, rows))
        for index, change in weighs.items():
            whole = to_reading(far / side * change[order])
            whole[:, index] += of_row[:, index]
            of_row[:, index] = 0.0
            carried.setdefault(index, len(common))
            common.append((group, whole))
        own.append((group, of_row))
        if reference is not None:
            rows = model.assembly.rows(model.mesh.deflection_at(reference, *order)) @ modal.shape
            other.append((group, to_reading(far / side * from_responses(modal, rows))))
    level = imperfections.std("calibration_std")
    group, level = ("calibration_std", level) if level > mesh[1] else ("mesh", mesh[1])
    if level > 0:
        own.append((group, level * reading))
        of_response.append("level")
        if n_reference > 1:
            other.append((group, level * reading))
            of_reference.append("level")
    drift = imperfections.std("frequency_drift")
    if drift > 0 and max(n_response, n_reference) > 1:
        # A file does not say whether sensors or hits were moved from record to record.
        if drifting is None:
            moved = 2 * drift * modal.eigenvalue * modal.kappa
            drifted = to_reading(as_modes_move(modal, moved))
        else:
            drifted = drift * drifting
        for count, part, what in ((n_response, own, of_response), (n_reference, other, of_reference)):
            if count > 1:
                part.append(("frequency_drift", drifted))
                what.append("drift")

    nothing = torch.zeros_like(modal.eigenvalue)
    left = 1.0 if about is None or about.channels is None else about.channels.drift_left()
    moving: dict[str, Tensor] = {"frequency_drift": 2 * drift * left * modal.eigenvalue, "mesh": nothing.clone()}
    moving["mesh"][elastic] = 2 * shift * modal.eigenvalue[elastic]
    # By each term, of the modes in the band and a little above it.
    each = (stiffness - modal.eigenvalue * mass).diagonal(dim1=-2, dim2=-1).mT.clone()
    each[modal.n_low :] = 0.0
    if about is None:
        for one, moved in zip(every, each.mT, strict=True):
            moving[one.name] = (moving.get(one.name, nothing).square() + moved.square()).sqrt()
    scatter = torch.full_like(modal.eigenvalue, damped)
    if about is not None:
        k = len(every)
        moving["found"] = ((each @ about.spread[:k, :k]) * each).sum(-1).clamp(min=0).sqrt()
        known = about.spread.diagonal()[k:].clamp(min=0).sqrt()
        scatter[: len(known)] *= known
    plain = chain._replace(reading=None)
    factor = as_kind(torch.ones_like(reading), plain, "accelerance" if kind == "transmissibility" else kind)
    second_order = SecondOrder(
        moving,
        scatter,
        about is None,
        modal.kappa.abs(),
        modal.damping.abs(),
        modal.denominator.abs(),
        (modal.left[:, None] * modal.right[None]).square().flatten(0, 1),
        places_again(model, modal, chain.response, reference, [off / side for side in sides], about),
        factor.abs().square(),
        chain.reading,
        each,
    )
    columns = [real_columns([change for _, change in part], reading) for part in (common, own, other)]
    names = [tuple(name for name, _ in part) for part in (common, own, other)]
    groups = (names[0], names[1], names[2])
    return Nuisances(
        columns[0],
        columns[1],
        columns[2],
        groups,
        second_order,
        n_off,
        about,
        tuple(of_response),
        tuple(of_reference),
        level,
        drift,
        carried,
        support,
        of_support,
    )


@torch.no_grad()
def specimen_columns(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    frequency: Float[Tensor, " n_frequency"],
    specimens: Specimens,
    decay: float | Float[Tensor, " n_frequency"] = 0.0,
) -> Complex[Tensor, "n_frequency n_response n_reference n_off"]:
    """What each way to be off, one standard deviation large, adds to the FRFs of a specimen.

    Args:
        model: the specimen.
        theta: its searched parameters.
        frequency: lines [Hz].
        specimens: in the model's basis.
        decay: σ of s = iω + σ [1/s].
    """
    _, _, modal, to_reading = _apart(model, theta, frequency, decay)
    shape = modal.shape
    stiffness, mass = (shape.mT @ part @ shape for part in (specimens.stiffness, specimens.mass))
    changes = through_each(modal, stiffness, mass, to_reading.chain.laplace)
    found = to_reading(changes)
    del changes
    damped = to_reading(_damped(modal, len(specimens.names) - len(found), specimens.damping))
    return torch.cat([found, damped]).movedim(0, -1)


def place_std(imperfections: Imperfections, mesh: tuple[float, float]) -> float:
    """How well the place of a channel is known [m]: no better than the mesh's lines of equal deflection are.

    Args:
        imperfections: of the test.
        mesh: what the mesh leaves of the deflections: distance by which these lines are off [m], and part of them [-].
    """
    return max(imperfections.std("position_std"), mesh[0])


@torch.no_grad()
def matrix_columns(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    frequency: Float[Tensor, " n_frequency"],
    stiffness: Float[Tensor, "n_change n n"],
    mass: Float[Tensor, "n_change n n"],
    decay: float | Float[Tensor, " n_frequency"] = 0.0,
    lossy: bool = False,
) -> Complex[Tensor, "n_change n_frequency n_response n_reference"]:
    """What changes of the matrices, each alone, add to the FRFs, to first order.

    Args:
        model: in a basis.
        theta: its searched parameters.
        frequency: lines [Hz].
        stiffness: of each change, in the model's coordinates [N/m].
        mass: likewise [kg].
        decay: σ of s = iω + σ [1/s].
        lossy: the stiffness is one of loss, i times it, whatever the loss factor of the whole.
    """
    _, _, modal, to_reading = _apart(model, theta, frequency, decay)
    shape = modal.shape
    laplace = to_reading.chain.laplace
    return to_reading(through_each(modal, shape.mT @ stiffness @ shape, shape.mT @ mass @ shape, laplace, lossy))


def modes_damped(model: PlateModel, theta: Float[Tensor, " n_parameter"], frequency: Tensor) -> int:
    """How many modes lie in the band or not too far above it: those whose damping is seen.

    Args:
        model: in a basis.
        theta: its searched parameters.
        frequency: lines [Hz].
    """
    plan = model.plan(theta)
    system = model.assembly.system(*plan)
    eigenvalue, _ = solve_modes(system.stiffness, system.mass)
    return int((eigenvalue < _top(frequency, DAMPED)).sum())


def _top(frequency: Tensor, times: float) -> float:
    """The eigenvalue at so many times the end of a band [rad²/s²]."""
    return (2 * math.pi * times * float(frequency[-1])) ** 2


def _damped(modal: Modal, n: int, damping: float) -> Tensor:
    """Receptances as ln damping of each of the lowest modes, alone, grows by this."""
    change = 1j * damping * modal.own_damping[:n]
    return of_modes(modal, torch.arange(n), change.expand(len(modal.denominator), n))


class _Reading(NamedTuple):
    """From a change of receptance to a change of the reading."""

    chain: SensorChain
    kind: str

    def __call__(self, change: Tensor) -> Tensor:
        found = as_kind(change, self.chain, self.kind)
        if self.kind != "transmissibility":
            return found
        return found - as_kind(change.new_zeros(change.shape[-3:]), self.chain, self.kind)


def _apart(
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    frequency: Float[Tensor, " n_frequency"],
    decay: float | Float[Tensor, " n_frequency"] = 0.0,
) -> tuple[Plan, Tensor | None, Modal, _Reading]:
    """What a model is made of at these lines, its references and modes, and how it is read."""
    plan = model.plan(theta)
    response, reference, kind = model._points(None, None, None)
    chain = model.chain(theta, plan, laplace_lines(frequency.to(theta), decay), response, reference, own=True)
    reference = model.struck(reference)
    modal = by_modes(model, plan, chain.laplace, chain.response, reference)
    return plan, reference, modal, _Reading(chain, kind)


def real_columns(
    parts: Sequence[Complex[Tensor, "n_frequency n_response n_reference"]],
    like: Complex[Tensor, "n_frequency n_response n_reference"],
) -> Float[Tensor, "n_frequency n_response n_reference 2 n_part"]:
    """Some changes of the FRFs beside each other, real and imaginary parts.

    Args:
        parts: each change; with conjugate bits or without.
        like: the FRFs, for where there is none.
    """
    found = like.real.new_zeros(*like.shape, 2, len(parts))
    # Some lines at a time: what is written then stays in the processor's cache.
    for lines in torch.arange(len(like)).split(max(1, AT_ONCE // max(1, found[:1].numel()))):
        some = slice(int(lines[0]), int(lines[-1]) + 1)
        for index, part in enumerate(parts):
            found[some, ..., index] = torch.view_as_real(part[some].resolve_conj())
    return found
