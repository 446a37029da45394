"""What a reference test says of a plate: its parameters and its specimen, with their joint covariance.

The posterior of one test is the prior of the next. Its covariance is needed whole: how a natural frequency is made up
of modulus, section and what the model leaves of the mode is hardly known, their sum to a small part of a peak's width.
Standard deviations alone would make that sum as uncertain as its parts, and no change would ever show.

Source: Lindley, Bayesian Statistics, a Review (1972): today's posterior is tomorrow's prior.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.basins import fit_from_the_box
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.change.specimen import OwnModes, ReferenceSpecimens
from torchplate.diagnosis.joint import Ended, Joint
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.posterior import UNIFORM
from torchplate.diagnosis.problem import Prior
from torchplate.discrepancy import OfChannels, Wandering, modes_damped, place_std, specimen_columns
from torchplate.model import PlateModel, solve_eigenvalues
from torchplate.search import JACOBIANS


@dataclass(frozen=True, eq=False)
class Reference:
    """A fitted reference test.

    Attributes:
        names: of the parameters that it says something of.
        position: of these, on the unit cube.
        shift: of the specimen, in standard deviations.
        covariance: of both, position first.
        drift: how far both may be off in the next test, a column each: all modes alike, each mode, each damping.
        values: of all parameters, known ones too, in SI units.
        modes: those with a stiffness of their own.
        eigenvalue: ω² of these in the specimen that was found [rad²/s²].
        wandering: how far the section may wander.
        damping: standard deviation of each mode's ln damping [-].
        n_section: terms of the section, which come first in the shift.
        noise_scale: what it leaves, over the noise [-]; 1 where that is all.
        place: standard deviation of the place of a channel, as it is said of the test after [m].
        sizes: of its channels' nuisances, over what was said of them [-].
        fit: of the model without modes of their own.
        settings: what is taken for granted.
    """

    names: tuple[str, ...]
    position: Float[Tensor, " n"]
    shift: Float[Tensor, " n_off"]
    covariance: Float[Tensor, "n_all n_all"]
    drift: Float[Tensor, "n_all n_drift"]
    values: Mapping[str, float]
    modes: OwnModes
    eigenvalue: Float[Tensor, " n_mode"]
    wandering: Wandering
    damping: float
    n_section: int
    noise_scale: float
    place: float
    sizes: Mapping[str, float]
    fit: Fit
    settings: ChangeSettings

    def specimens(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> ReferenceSpecimens:
        """In a model's own coordinates."""
        stiffness, place = self.settings.mode_stiffness, self.place
        return ReferenceSpecimens(model, theta, self.wandering, self.damping, self.modes, stiffness, place)

    @property
    def missed(self) -> float:
        """How far the model misses the modes: root mean square of ln f [-]."""
        first = self.n_section
        own = self.settings.mode_stiffness * self.shift[first : first + len(self.eigenvalue)]
        return float(own.square().mean().sqrt()) if len(own) else 0.0

    def drifted(self) -> "Reference":
        """What is known of the next test: the same, and how far a plate drifts from test to test."""
        settings, n_mode = self.settings, len(self.modes.eigenvalue)
        first = len(self.names) + self.n_section
        each = torch.eye(n_mode).to(self.covariance)
        drift = self.covariance.new_zeros(len(self.covariance), 1 + 2 * n_mode)
        drift[first : first + n_mode, 0] = settings.drift_all / settings.mode_stiffness
        drift[first : first + n_mode, 1 : 1 + n_mode] = each * settings.drift_mode / settings.mode_stiffness
        if self.damping > 0:
            drift[first + n_mode : first + 2 * n_mode, 1 + n_mode :] = each * settings.drift_damping / self.damping
        return replace(self, drift=drift)

    def half(self, without: Collection[str]) -> tuple[list[str], Float[Tensor, "n_left k"]]:
        """The parameters left where of some nothing is said, and R with R Rᵀ the covariance of these and the shift.

        The drift is its last columns.
        """
        names = [name for name in self.names if name not in without]
        kept = [k for k, name in enumerate(self.names) if name not in without]
        kept += list(range(len(self.names), len(self.covariance)))
        value, vector = torch.linalg.eigh(self.covariance[kept][:, kept])
        return names, torch.cat([vector * value.clamp(min=0.0).sqrt(), self.drift[kept]], dim=1)


@torch.no_grad()
def fit_reference(builder: ModelBuilder, prior: Prior, settings: ChangeSettings) -> Reference:
    """Fit the reference test: first the model, then beside modes of their own.

    Args:
        builder: of the model, against the reference test.
        prior: what is known of its parameters beforehand.
        settings: what is taken for granted.
    """
    target, model = builder.target, builder.given
    found = fit_from_the_box(builder, model, prior)
    # Where the section may not wander nor a damping scatter, nobody said that the model hits every mode.
    told = target.imperfections.std("damping_scatter")
    damping = max(settings.mode_damping, told) if told > 0 else 0.0
    theta = found.theta
    n_mode = modes_damped(found.reduced, theta, target.frequency)
    modes = OwnModes.of(found.model, found.reduced, theta, n_mode)
    # Both tests are on one mesh, its error taken off at one plate: this one.
    whole = builder.corrected(model, theta, anew=True).model
    plain = builder.reduced(whole, theta[None])
    place = place_std(target.imperfections, target.mesh_left)
    specimens = ReferenceSpecimens(plain, theta, target.wandering, damping, modes, settings.mode_stiffness, place)
    joint = Joint(builder, whole, specimens, prior)
    position, shift = model.space.to_cube(theta), _begun(found, specimens, told, damping)
    # Sensors off their marks, and what they weigh, are a part of what was found: without it the fit begins elsewhere.
    channels = None if found.about is None else found.about.channels
    starts = [(position, shift, channels)]
    if found.gap > target.settings.screening.overlapping:
        # What was found may have taken on what modes of their own would explain, and hold it.
        wide = target.settings.wide
        place_there, shift_there, _ = joint.descend(
            position, shift, target.levels - 2, wide.n_iteration[-1], wide.damping
        )
        starts.append((place_there, shift_there, None))
    ended = min((_settled(joint, start, settings) for start in starts), key=lambda one: one.cost)
    position, shift = ended.position, ended.found.shift
    theta = model.space.to_si(position)
    specimen = specimens.at(shift, ended.found.channels)
    about = ended.found._replace(shift=shift[:0], spread=ended.found.spread[:0, :0])
    marginal = target.marginal(specimen, theta, about, specimen=False)
    judged = marginal.judge(marginal.residual(target.off(builder.predict(specimen, theta), marginal.about)))
    columns = all_columns(builder, specimen, specimens, theta, list(model.names))
    information = marginal.precision(marginal.over_noise(columns.movedim(-1, 0)), judged)
    known = torch.cat([_told(model, theta, prior), torch.ones_like(shift)])
    precision = information + torch.diag(known)
    norm = precision.diagonal().sqrt()
    scaled = torch.linalg.inv(precision / norm[:, None] / norm)
    covariance = scaled / norm[:, None] / norm
    values = found.model.as_dict(theta)
    return Reference(
        model.names, position, shift, 0.5 * (covariance + covariance.mT), covariance[:, :0], values, modes,
        eigenvalues(specimen, theta)[:n_mode], target.wandering, damping,
        specimens.n_section, judged.noise_scale, place, judged.scale, found, settings,
    )  # fmt: skip


def _settled(
    joint: Joint,
    start: tuple[Float[Tensor, " n"], Float[Tensor, " n_off"], OfChannels | None],
    settings: ChangeSettings,
) -> Ended:
    """Where a start ends, and from there with a section as it is meant, as long as that falls.

    A section that stands in for what the model lacks keeps modes of their own from doing so.
    """
    ended = joint.descend_sharply(*start)
    for _ in range(settings.n_turn):
        again = joint.descend_sharply(ended.position, torch.zeros_like(start[1]))
        fallen = ended.cost - again.cost
        ended = again if fallen > 0 else ended
        if fallen < joint.settings.little:
            break
    return ended


def eigenvalues(model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> Float[Tensor, " n_mode"]:
    """Of a model in a basis [rad²/s²], the lowest first."""
    system = model.assembly.system(*model.plan(theta))
    return solve_eigenvalues(system.stiffness, system.mass)


def all_columns(
    builder: ModelBuilder,
    specimen: PlateModel,
    specimens: ReferenceSpecimens,
    theta: Float[Tensor, " n_parameter"],
    names: list[str],
) -> Complex[Tensor, "n_frequency n_response n_reference n_all"]:
    """What parameters, over the unit cube, and the specimen's terms do to the FRFs.

    Args:
        builder: what evaluates them.
        specimen: the model.
        specimens: in its basis.
        theta: its searched parameters.
        names: of the parameters that are wanted.
    """
    target, space = builder.target, specimen.space
    gain = target.gain_of(specimen, theta) if target.gain_is_unknown else 1.0
    terms = gain * specimen_columns(specimen, theta, target.frequency, specimens)
    if not names:
        return terms
    position, index = space.to_cube(theta), [specimen.names.index(name) for name in names]

    def along(places: Float[Tensor, "*batch n_some"]) -> Float[Tensor, "*batch n_number"]:
        whole = position.expand(*places.shape[:-1], len(position)).clone()
        whole[..., index] = places
        found = builder.predict(specimen, space.to_si(whole))
        return torch.view_as_real(found.resolve_conj()).flatten(-4)

    here = along(position[index])
    slope = JACOBIANS["central"].differentiate(along, position[index][None], here[None])[0]
    shape = (*terms.shape[:-1], 2, len(names))
    parts = torch.view_as_complex(slope.reshape(shape).movedim(-1, -2).contiguous())
    return torch.cat([parts, terms], dim=-1)


def _begun(found: Fit, specimens: ReferenceSpecimens, told: float, damping: float) -> Float[Tensor, " n_off"]:
    """The specimen as far as the model alone has told it: its section, and its damping on the wider scale."""
    shift = found.theta.new_zeros(len(specimens.names))
    if found.about is None:
        return shift
    before, n, n_mode = found.about.shift, specimens.n_section, len(specimens.names) - specimens.n_term
    shift[:n] = before[:n]
    own = before[n : n + n_mode]
    if n_mode:
        shift[specimens.n_term : specimens.n_term + len(own)] = own * told / damping
    return shift


def _told(model: PlateModel, theta: Float[Tensor, " n"], prior: Prior) -> Float[Tensor, " n"]:
    """Inverse variance of each parameter on the unit cube, as it was known before."""
    step = 1e-6
    position = model.space.to_cube(theta)
    slope = (model.space.to_si(position + step) - model.space.to_si(position - step)) / (2 * step)
    std = torch.tensor([prior[name][1] if name in prior else math.inf for name in model.names]).to(theta)
    return torch.where(std.isinf(), UNIFORM, (slope / std).square())
