"""The model of one measured plate, as a torch module: parameters in, FRFs and natural frequencies out."""

import copy
import functools
from collections.abc import Callable, Iterator
from typing import Any

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.effects import Effect, SensorChain
from torchplate.model.arguments import Numbers, Points, as_frequency, left_out
from torchplate.model.plate_variants import PlateVariants
from torchplate.model.receptance.batched import joined
from torchplate.model.receptance.frf import (
    as_kind,
    direct_receptance,
    laplace_lines,
    lines_at_once,
    sensor_chain,
    with_sensor_mass,
)
from torchplate.model.receptance.modal_solution import modal_solution
from torchplate.model.receptance.modal_sum import MEMBERS_AT_ONCE
from torchplate.model.receptance.modes import Modes, natural_frequencies, solve_eigenvalues, solve_modes
from torchplate.model.receptance.rearranged import rearranged
from torchplate.plate import Plan, System, concatenate, transformed, uneven_mass_coefficient


class PlateModel(PlateVariants):
    """A plate with its effects; some of their parameters are known, the others are searched.

    Called, it is `frf`. Its numbers stay in double precision whatever dtype it is moved to, and results have theta's:
    the highest of all eigenvalues is 1e5 times and more those of the measured modes, so that in single precision their
    rounding is as large as these (1.5 % of an FRF, 14 % near rigid-body motion on soft springs).

    Args:
        mesh: the mesh.
        effects: label → effect, in the order in which they act.
        known: "label.parameter" → value in SI units.
        searched: "label.parameter" → interval. A parameter in neither takes its neutral value.
        response: where the FRFs are read unless a call says otherwise: node labels or relative places, or one of them.
            Places whose gradient is wanted go to `frf`.
        reference: where the force acts, likewise.
        kind: of the FRFs: receptance, mobility, accelerance, or transmissibility (response over the motion of the
            held edges; springs and dashpots to the ground then ride on that motion too).
        memory: bytes that one evaluation may take; larger populations go in chunks.
        assembly: of this mesh, to share with other models; left out, one is made.

    Raises:
        ValueError: if there is not exactly one plate, a parameter is missing, unknown or outside what makes sense, or a
            response or reference is inside a hole.
    """

    def system(self, theta: Float[Tensor, "*batch n_parameter"]) -> System:
        """Mass, stiffness and damping; what no searched parameter touches has no batch dimension."""
        return self.assembly.system(*self.plan(theta))

    def modes(self, theta: Numbers, *, check: bool = True) -> Modes:
        """All undamped modes, one `torch.linalg.eigh` for the batch.

        A mass on a spring adds a mode; the shapes are those of the plate, the motion of such masses left out.

        Shapes have no derivative where frequencies repeat: differentiate `frf` or `natural_frequencies` instead.

        Args:
            theta: as for `frf`.
            check: likewise.
        """
        theta, single = self._theta(theta, check)
        system = self.system(theta)
        value, shape = solve_modes(*system.undamped())
        modes = Modes(value, shape[..., : self.assembly.size, :])
        return Modes(*(part.float() for part in modes)) if single else modes

    def on(self, device: torch.device | str) -> "PlateModel":
        """The same model with its tensors on `device`; this one's stay where they are."""
        return self if self.known.device == torch.device(device) else copy.deepcopy(self).to(device)

    def natural_frequencies(
        self, theta: Numbers, n_mode: int = 20, *, check: bool = True
    ) -> Float[Tensor, "*batch n_mode"]:
        """The lowest undamped natural frequencies [Hz], rigid-body modes first.

        Differentiable by dω² = φᵀ(dK − ω² dM)φ, which divides by no gap. Where frequencies repeat, what does not
        depend on the order within the cluster (its sum, its mean) has the right gradient; a single member has the one
        along the eigenvector that the solver picked, between the slopes of the branches that meet there. A rigid-body
        mode's is zero, or as small as its frequency. Second derivatives exist only where no frequency repeats.

        Args:
            theta: as for `frf`.
            n_mode: how many.
            check: as for `frf`.

        Raises:
            ValueError: if the model has fewer modes than that, or theta cannot be meant.
        """
        theta, single = self._theta(theta, check)
        if n_mode > self.assembly.size:
            raise ValueError(
                f"Expected at most {self.assembly.size} modes, got {n_mode}. Refine the mesh or ask for fewer."
            )
        if not theta.shape[:-1].numel():
            empty = theta.new_zeros(*theta.shape[:-1], n_mode) + 0 * theta.sum()
            return empty.float() if single else empty
        parts = []
        for members in self._chunks(theta):
            system = self.system(members)
            eigenvalue = solve_eigenvalues(*system.undamped())[..., :n_mode]
            parts.append(natural_frequencies(eigenvalue).expand(len(members), n_mode))
        found = joined(parts, 0).reshape(*theta.shape[:-1], n_mode)
        return found.float() if single else found

    def frf(
        self,
        theta: Numbers | None = None,
        frequency: Numbers | None = None,
        response: Points | None = None,
        reference: Points | None = None,
        kind: str | None = None,
        decay: float | Tensor = 0.0,
        *,
        check: bool = True,
    ) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
        """Frequency response functions of every member.

        Args:
            theta: searched parameters in SI units, in the order of `names`. A tensor, an array or a list; of single
                precision, the result is too.
            frequency: lines [Hz], ≥ 0; a single number is one line.
            response: node labels or relative places (x, y), or one of them; left out, those of the measurement. A
                tensor of places [n_point, 2] has a gradient.
            reference: likewise; a transmissibility has none.
            kind: receptance [m/N], mobility [m/(N s)], accelerance [m/(N s²)] or transmissibility [-]; left out, that
                of the measurement.
            decay: σ of s = iω + σ [1/s]: what the FRF is of records windowed by exp(−σt); a
                tensor has one for each line.
            check: refuse a theta that no plate has, such as one in the unit cube. Nothing is checked inside a
                transform of torch.func, nor in a reduced basis on a GPU.

        Raises:
            ValueError: if a place or the kind is unknown, none is given and the model has no measurement, or theta or
                the lines are left out or cannot be meant.
        """
        if theta is None or frequency is None:
            raise left_out(theta is None, self.names)
        points = self._points(response, reference, kind)
        theta, single = self._theta(theta, check)
        laplace = laplace_lines(as_frequency(frequency, theta, check), decay)
        own = response is None and reference is None
        if not theta.shape[:-1].numel() or not len(laplace):
            n_reference = 1 if points[1] is None else len(points[1])
            shape = (*theta.shape[:-1], len(laplace), len(points[0]), n_reference)
            found = laplace.new_zeros(shape) + 0 * theta.sum()
        else:
            parts = [self._frf(members, laplace, points, own) for members in self._chunks(theta)]
            found = joined(parts, 0).reshape(*theta.shape[:-1], *parts[0].shape[1:])
        return found.to(torch.complex64) if single else found

    def forward(
        self, theta: Numbers | None = None, frequency: Numbers | None = None, *points: Any, **options: Any
    ) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
        """`frf`, which a module runs when it is called.

        Args:
            theta: as for `frf`.
            frequency: likewise [Hz].
            points: response, reference and what follows them in `frf`.
            options: likewise, by name.

        Raises:
            ValueError: as `frf`, and if theta or the lines are left out.
        """
        return self.frf(theta, frequency, *points, **options)

    def _frf(
        self, theta: Tensor, laplace: Tensor, points: tuple[Tensor, Tensor | None, str], own: bool
    ) -> Complex[Tensor, "n_member n_frequency n_response n_reference"]:
        plan = self.plan(theta)
        if self.shared_modes is not None:
            in_single = self.in_single and not torch.is_grad_enabled() and not transformed()
            of_plan = functools.partial(self.shared_modes.receptance, self.assembly, plan, in_single=in_single)
            whole = self._observed(theta, plan, laplace, points, of_plan, own)
            return whole.expand(len(theta), *whole.shape[-3:])
        system = self.assembly.system(*plan)
        at_once = functools.partial(lines_at_once, self.memory // 2, len(theta))
        solve = modal_solution(system, at_once, self.damping_factor, self.couples_modes)
        whole = self._observed(theta, plan, laplace, points, solve, own)
        return whole.expand(len(theta), *whole.shape[-3:])

    def frf_direct(
        self,
        theta: Numbers,
        frequency: Numbers,
        response: Points | None = None,
        reference: Points | None = None,
        kind: str | None = None,
        decay: float | Tensor = 0.0,
        *,
        check: bool = True,
    ) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
        """The same as `frf`, by solving the dynamic stiffness at every line: slow, and independent of any mode."""
        points = self._points(response, reference, kind)
        theta, single = self._theta(theta, check)
        plan = self.plan(theta)
        system = self.assembly.system(*plan)
        solve = functools.partial(direct_receptance, system)
        laplace = laplace_lines(as_frequency(frequency, theta, check), decay)
        whole = self._observed(theta, plan, laplace, points, solve, response is None and reference is None)
        found = whole.expand(*theta.shape[:-1], *whole.shape[-3:])
        return found.to(torch.complex64) if single else found

    def observed(
        self,
        theta: Float[Tensor, "*batch n_parameter"],
        plan: Plan,
        frequency: Float[Tensor, " n_frequency"],
        solve: Callable[[Tensor, Tensor, Tensor], Tensor],
    ) -> Complex[Tensor, "*batch n_frequency n_response n_reference"]:
        """The measurement's FRFs, from any way to solve for receptances.

        Args:
            theta: searched parameters in SI units.
            plan: what the effects make of them.
            frequency: lines [Hz].
            solve: from s, response rows and reference rows to receptances.
        """
        laplace = laplace_lines(frequency.to(theta), 0.0)
        return self._observed(theta, plan, laplace, self._points(None, None, None), solve, own=True)

    def _observed(
        self,
        theta: Tensor,
        plan: Plan,
        laplace: Tensor,
        points: tuple[Tensor, Tensor | None, str],
        solve: Callable[[Tensor, Tensor, Tensor], Tensor],
        own: bool = False,
    ) -> Tensor:
        """Receptances as the sensor chain reports them, at the model's own points or at others."""
        response, reference, kind = points
        chain = self.chain(theta, plan, laplace, response, reference, own)
        reference = self.struck(reference) if own else reference
        left = self.assembly.rows(self.mesh.deflection_at(chain.response))
        of_plate = self._with_hung(plan, reference, solve)
        right = self.excitation(plan, reference)
        if chain.mass is not None:
            return as_kind(with_sensor_mass(of_plate, chain, left, right, reference is None), chain, kind)
        return as_kind(of_plate(chain.laplace, left, right), chain, kind)

    def _with_hung(
        self, plan: Plan, reference: Tensor | None, solve: Callable[[Tensor, Tensor, Tensor], Tensor]
    ) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
        """A solve whose first column is the plate under a base that moves, with what masses on springs do to that."""
        hung = [term for term in plan.terms if term.sprung is not None]
        if reference is not None or not hung:
            return solve

        def loaded(laplace: Tensor, left: Tensor, right: Tensor) -> Tensor:
            # Masses on springs load the plate by what they would weigh at each s, D(s)/s², where its base moves.
            rows = [right, *(self.assembly.rows(term.vector) for term in hung)]
            n = right.shape[-2]
            found = solve(laplace, left, concatenate(rows, 2))
            forces = [term.sprung.force(laplace) for term in hung if term.sprung is not None]
            weight = (concatenate(forces, 2) / laplace[..., None, :] ** 2).mT[..., None, :]
            first = found[..., :1] + (found[..., n:] * weight).sum(-1, keepdim=True)
            return torch.cat([first, found[..., 1:n]], dim=-1)

        return loaded

    def struck(self, reference: Tensor | None) -> Tensor | None:
        """Where the model's own hits are, off their marks as they are."""
        off = None if self.off_marks is None else self.off_marks.reference
        return reference if reference is None or off is None else reference + off

    def chain(
        self, theta: Tensor, plan: Plan, laplace: Tensor, response: Tensor, reference: Tensor | None, own: bool
    ) -> SensorChain:
        """What is read, of the model's own points or of others."""
        chain, value = sensor_chain(laplace, response, reference), self.values(theta)
        if own and self.off_marks is not None:
            chain = chain._replace(response=chain.response + self.off_marks.response)
        for label, effect in self.effects.items():
            chain = effect.observe(self.mesh, chain, value[label], plan.geometry)
        return chain

    def rearranged(
        self, frf: Complex[Tensor, "*batch n_frequency n_response n_reference"], effect: Effect
    ) -> Complex[Tensor, "*batch n_frequency n_response n_reference"] | None:
        """The measurement's FRFs as one more effect would report them that only exchanges or turns channels.

        Args:
            frf: as this model reports them.
            effect: without parameters, the last of the sensor chain.

        Returns:
            Them; None for an effect that does more than that.
        """
        response, reference, _ = self._points(None, None, None)
        return rearranged(frf, effect, self.mesh, self._nominal(), response, reference)

    def has_hole(self, theta: Numbers) -> bool:
        """Whether there is a hole, a notch or a missing corner, left out of the mesh or made by an effect."""
        return bool(self.mesh.cut) or self.plan(self._theta(theta, False)[0]).section.uneven_density is not None

    def excitation(self, plan: Plan, reference: Tensor | None) -> Float[Tensor, "*batch n_reference n"]:
        """Rows of the forces; the base's unit acceleration loads the plate with its inertia."""
        if reference is not None:
            return self.assembly.rows(self.mesh.deflection_at(reference))
        heavy = uneven_mass_coefficient(plan.section, plan.geometry)
        load = self.assembly.translation_load(plan.section.areal_mass, plan.geometry, heavy)
        for term in plan.terms:
            if term.mass is not None:
                # A deflection row times the rigid translation is one.
                load = load + (term.mass[..., None] * self.assembly.rows(term.vector)).sum(-2)
        for one in plan.added:
            # Where all places move alike, each counts once.
            pushed = self.assembly.spread_rows(one).mT @ one.coupling.to(load).sum(-1)
            load = load + one.coefficient[..., None] * pushed
        return load[..., None, :]

    def _chunks(self, theta: Tensor) -> Iterator[Tensor]:
        """Members that fit half of the memory with their matrices and modes, on a CPU at most as many as pay.

        What sits along lines has rows over all dofs of the mesh for each: an eighth of the memory is theirs.
        """
        flat = theta.reshape(theta.shape[:-1].numel(), theta.shape[-1])
        fitting = self.memory // 2 // (8 * theta.element_size() * self.assembly.size**2)
        if self.shared_modes is not None:
            fitting = max(fitting, MEMBERS_AT_ONCE)
        if theta.device.type == "cpu":
            fitting = min(fitting, MEMBERS_AT_ONCE)
        n_row = sum(effect.n_row(self.mesh) for effect in self.effects.values())
        fitting = min(fitting, self.memory // 8 // (theta.element_size() * n_row * self.mesh.n_dof))
        # A power of two, so that a member has the same place in its chunk if the batch is parted at one.
        return iter(flat.split(1 << max(0, fitting.bit_length() - 1)))
