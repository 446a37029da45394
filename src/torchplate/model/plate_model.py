"""The model of one measured plate, as a torch module: parameters in, FRFs and natural frequencies out."""

import copy
import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import torch
from jaxtyping import Complex, Float
from torch import Tensor, nn

from torchplate.effects import Effect, Plate, Searched, SensorChain
from torchplate.model.arguments import (
    Numbers,
    Point,
    Points,
    as_frequency,
    as_points,
    as_theta,
    check_range,
    limits,
)
from torchplate.model.declared import declared
from torchplate.model.frf import (
    KINDS,
    as_kind,
    direct_receptance,
    joined,
    laplace_lines,
    lines_at_once,
    sensor_chain,
    with_sensor_mass,
)
from torchplate.model.modal_solution import modal_solution
from torchplate.model.modal_sum import MEMBERS_AT_ONCE
from torchplate.model.modes import Modes, natural_frequencies, solve_eigenvalues, solve_modes
from torchplate.model.off_marks import OffMarks, carried_masses
from torchplate.model.rearranged import rearranged
from torchplate.model.shared_modes import SharedModes
from torchplate.plate import Assembly, Geometry, Local, Mesh, Plan, System, concatenate, transformed

# Greatest error of an FRF in relative norm for which a search is done in single precision; least squares finish it.
SINGLE_TOLERANCE = 1e-4


class PlateModel(nn.Module):
    """A plate with its effects; some of their parameters are known, the others are searched.

    Called, it is `frf`. Its numbers stay in double precision whatever dtype it is moved to, and results have theta's:
    the highest of all eigenvalues is 1e5 times and more those of the measured modes, so that in single precision their
    rounding is as large as these (1.5 % of an FRF, 14 % near rigid-body motion on soft springs).

    Args:
        mesh: the mesh.
        effects: label → effect, in the order in which they act.
        known: "label.parameter" → value in SI units.
        searched: "label.parameter" → interval. A parameter in neither takes its neutral value.
        response: where the FRFs are read unless a call says otherwise: node labels or relative places.
        reference: where the force acts, likewise.
        kind: of the FRFs: receptance, mobility, accelerance, or transmissibility (response over the motion of the
            held edges; springs and dashpots to the ground then ride on that motion too).
        memory: bytes that one evaluation may take; larger populations go in chunks.
        assembly: of this mesh, to share with other models; left out, one is made.

    Raises:
        ValueError: if there is not exactly one plate, a parameter is missing, unknown or outside what makes sense, or a
            response or reference is inside a hole.
    """

    known: Tensor
    limit: Tensor

    def __init__(
        self,
        mesh: Mesh,
        effects: Mapping[str, Effect],
        known: Mapping[str, float],
        searched: Mapping[str, Searched] | None = None,
        response: Sequence[Point] | None = None,
        reference: Sequence[Point] | None = None,
        kind: str = "receptance",
        memory: int = 2**30,
        assembly: Assembly | None = None,
    ) -> None:
        super().__init__()
        self.effects = dict(effects)
        self.response, self.reference, self.kind, self.memory = response, reference, kind, memory
        if sum(isinstance(effect, Plate) for effect in self.effects.values()) != 1:
            raise ValueError("Expected exactly one effect `plate` in the model, got none or several. Keep one.")
        # The plate comes first and what changes other effects last, whatever their order in a config.
        self.effects = dict(sorted(self.effects.items(), key=lambda item: item[1].stage))
        for effect in self.effects.values():
            mesh = effect.discretise(mesh)
        for name, points in (("response", response), ("reference", reference)):
            if mesh.cut and points is not None:
                mesh.check_on_plate(mesh.places(as_points(points, name)).tolist())
        self.mesh = mesh
        values, self._searched, self.space = declared(self.effects, known, searched or {})
        self.register_buffer("known", torch.tensor(values, dtype=torch.float64))
        self.register_buffer("limit", limits(self.space, self._searched), persistent=False)
        self.assembly = Assembly(mesh) if assembly is None else assembly
        self.shared_modes: SharedModes | None = None
        self.couples_modes, self.in_single = True, False
        self.damping_factor: Tensor | None = None
        self.off_marks: OffMarks | None = None
        # Made now, because what is first made inside a torch.func transform belongs to that transform.
        for name, member in vars(Mesh).items():
            if isinstance(member, functools.cached_property):
                getattr(mesh, name)
        # Nobody is asked for channels yet; a place that is none is near no label.
        nowhere = self.known.new_full((1, 2), math.nan)
        self._check_effects(nowhere, nowhere)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "PlateModel":
        """What `to`, `float` and `cuda` do to the tensors: they move, and floating-point ones keep their precision."""

        def moved(tensor: Tensor) -> Tensor:
            found = fn(tensor)
            return tensor.to(found.device) if found.dtype != tensor.dtype else found

        return super()._apply(moved, recurse)

    def check_channels(self) -> None:
        """Whether the effects can be had with the model's own responses and references.

        Raises:
            ValueError: if not, with the label of the effect.
        """
        response, reference, _ = self._points(None, None, None)
        self._check_effects(response, reference)

    @torch.no_grad()
    def _check_effects(self, response: Tensor, reference: Tensor | None) -> None:
        """Nodes, supports and channels that are not there, told before anything is computed."""
        middle = self.space.to_si(torch.full((len(self.names),), 0.5).to(self.known))
        value, geometry = self.values(middle), self._nominal()
        chain = sensor_chain(laplace_lines(self.known.new_ones(1), 0.0), response, reference)
        terms: Sequence[Local] = []
        for label, effect in self.effects.items():
            try:
                if self.mesh.cut:
                    self.mesh.check_on_plate([*getattr(effect, "nodes", ()), *getattr(effect, "at", ())])
                terms = effect.attached(self.mesh, terms, value[label])
                effect.added_mass(self.mesh, geometry, value[label])
                chain = effect.observe(self.mesh, chain, value[label], geometry)
            except ValueError as error:
                raise ValueError(f"{label}: {error}") from None

    def _nominal(self) -> Geometry:
        return Geometry(*(self.known.new_tensor(side) for side in (self.mesh.length_x, self.mesh.length_y)))

    @property
    def names(self) -> tuple[str, ...]:
        """The searched parameters, in theta's order: "label.parameter"."""
        return self.space.names

    @property
    def units(self) -> tuple[str, ...]:
        """Their SI units."""
        return self.space.units

    @property
    def known_values(self) -> dict[str, float]:
        """Values of all that is not searched: "label.parameter" → value in SI units."""
        return {
            key: value
            for key, value in self._everything(self.known.new_zeros(len(self.names)))
            if key not in self.names
        }

    @property
    def searched(self) -> dict[str, Searched]:
        """Intervals of all that is searched, by "label.parameter"."""
        ends = zip(self.space.low.tolist(), self.space.high.tolist(), self.space.logarithmic.tolist(), strict=True)
        return {name: Searched(*one) for name, one in zip(self.names, ends, strict=True)}

    def as_dict(self, theta: Float[Tensor, " n_parameter"]) -> dict[str, float]:
        """All parameters of one member: "label.parameter" → value in SI units, known and searched.

        Args:
            theta: its searched parameters.
        """
        return dict(self._everything(theta))

    def replaced(
        self,
        *,
        effects: Mapping[str, Effect] | None = None,
        known: Mapping[str, float] | None = None,
        searched: Mapping[str, Searched] | None = None,
    ) -> "PlateModel":
        """A model of the same mesh, assembly and channels, and of other effects or numbers.

        What is left out stays as it is, dampings that are off their law too; of effects that are no longer there it
        goes. An effect that has split the mesh goes too, since the mesh is already what it has made of it.

        Args:
            effects: label → effect.
            known: "label.parameter" → value in SI units.
            searched: "label.parameter" → interval; what is also known is searched.

        Raises:
            ValueError: as for a new model.
        """
        every = self.effects if effects is None else effects
        kept = {label: effect for label, effect in every.items() if effect.discretise(self.mesh) is self.mesh}
        parameters = {f"{label}.{name}" for label, effect in kept.items() for name in effect.parameters}
        own = {key: value for key, value in self.known_values.items() if key in parameters}
        box = {key: interval for key, interval in self.searched.items() if key in parameters}
        found = PlateModel(
            self.mesh,
            kept,
            own if known is None else known,
            box if searched is None else searched,
            self.response,
            self.reference,
            self.kind,
            self.memory,
            self.assembly,
        ).to(self.known.device)
        found.damping_factor, found.couples_modes = self.damping_factor, self.couples_modes
        found.off_marks = self.off_marks
        return found

    def extra_repr(self) -> str:
        """One line for `print(model)`."""
        return (
            f"effects={list(self.effects)}, searched={list(self.names)}, n_dof={self.assembly.size}, kind={self.kind}"
        )

    def _twin(self) -> "PlateModel":
        """The same model, of which attributes can be changed; what they hold is shared."""
        twin = copy.copy(self)
        twin._modules = dict(self._modules)
        return twin

    def projected(
        self, basis: Float[Tensor, "n_free n_basis"], shared_modes: SharedModes | None = None
    ) -> "PlateModel":
        """The same model with all matrices projected on a basis over the free dofs; see `reduced_basis`.

        Args:
            basis: its columns.
            shared_modes: of all members, if they have any; the columns are then these modes.
        """
        twin = self._twin()
        section = self.plan(self.space.to_si(torch.full((len(self.names),), 0.5).to(self.known))).section
        by_element = any(part is not None and part.shape[-1] > 1 for part in section)
        # On all dofs, members that share their modes need no matrix any more.
        dense = shared_modes is None or basis.shape[0] != basis.shape[1]
        twin.assembly = Assembly(self.mesh, basis.cpu(), by_element, self.assembly.correction, dense).to(basis)
        twin.shared_modes = shared_modes
        return twin

    def without_coupling(self) -> "PlateModel":
        """The same model, where a loss in a part of the plate damps each mode and couples none.

        Of ΦᵀHΦ the diagonal alone is kept (Lord Rayleigh, The Theory of Sound, 2nd ed. 1894, section 102): off by the
        square of the loss factor over how far modes are apart, and several times as fast. For values alone: its
        gradients are those of the modes held as they are.
        """
        twin = self._twin()
        twin.couples_modes = False
        return twin

    def with_damping_factors(self, factor: Float[Tensor, " n_mode"] | None) -> "PlateModel":
        """The same model, each mode's damping a number of times what its law makes of it: no plate obeys one exactly.

        Args:
            factor: of the lowest modes [-], ≥ 0; modes beyond keep theirs. None where all obey the law.

        Raises:
            ValueError: if the model is in a basis of shared modes, which takes one law for all.
        """
        if self.shared_modes is not None and factor is not None:
            raise ValueError(
                "Expected a model with matrices of its own, got one in a basis of shared modes. Give the model before "
                "`reduce`, or in the basis of `ritz_basis`."
            )
        twin = self._twin()
        twin.damping_factor = None if factor is None else factor.to(self.known)
        return twin

    def with_places_off(
        self, response: Float[Tensor, "n_response 2"] | None, reference: Float[Tensor, "n_reference 2"] | None = None
    ) -> "PlateModel":
        """The same model, whose own sensors and hits are off their marks; other points that are asked for are not.

        A point mass at a sensor's mark is the sensor's own and is off with it.

        Args:
            response: by how much, relative to the sides [-]; None where all are on their marks.
            reference: likewise; None where the plate is shaken by its edges.
        """
        twin = self._twin()
        if response is None:
            twin.off_marks = None
        else:
            off = None if reference is None else reference.to(self.known)
            twin.off_marks = OffMarks(response.to(self.known), off, self.carried())
        return twin

    def carried(self) -> dict[str, int]:
        """Labels of the point masses that are a sensor's own, and which of the model's own responses that is."""
        return carried_masses(self.effects, self.known_values, self._points(None, None, None)[0])

    def in_single_precision(self) -> "PlateModel":
        """The same model for searches: under `torch.no_grad` its FRFs are put together in single precision.

        Where all members share their modes (`reduce` tells) and no place is searched it is half as fast again, and off
        by 1e-6 to 1e-5 of an FRF's norm. Strong springs and masses take more digits: `reduce` measures what is left,
        `shared_modes.single_error`, and beyond `SINGLE_TOLERANCE` the model stays in double precision, as it does
        where members share no modes. How far a line is from a pole is found in double precision all the same, and
        derivatives never leave it.
        """
        twin = self._twin()
        twin.in_single = self.shared_modes is not None and self.shared_modes.single_error <= SINGLE_TOLERANCE
        return twin

    def values(self, theta: Float[Tensor, "*batch n_parameter"]) -> dict[str, dict[str, Tensor]]:
        """Label → parameter → value in SI units: [*batch] where searched, [] where known.

        Raises:
            ValueError: if theta does not have one value for each searched parameter.
        """
        if theta.shape[-1] != len(self.names):
            raise ValueError(
                f"Expected theta with a last dimension of {len(self.names)} ({', '.join(self.names) or 'none'}), "
                f"got {theta.shape[-1]}. `model.names` gives the order."
            )
        position = {name: index for index, name in enumerate(self.names)}
        known = iter(self.known)
        return {
            label: {
                name: theta[..., position[key]] if (key := f"{label}.{name}") in position else next(known)
                for name in effect.parameters
            }
            for label, effect in self.effects.items()
        }

    def _everything(self, theta: Float[Tensor, " n_parameter"]) -> Iterator[tuple[str, float]]:
        for label, own in self.values(theta).items():
            yield from ((f"{label}.{name}", float(value)) for name, value in own.items())

    def plan(self, theta: Float[Tensor, "*batch n_parameter"]) -> Plan:
        """What the effects make of theta: sides, section, local terms and damping."""
        value = self.values(theta)
        if self.off_marks is not None:
            value = self.off_marks.moved(value)
        pairs = [(effect, value[label]) for label, effect in self.effects.items()]
        geometry = self._nominal()
        for effect, own in pairs:
            geometry = effect.geometry(geometry, own)
        section = None
        for effect, own in pairs:
            section = effect.section(self.mesh, section, own)  # type: ignore[arg-type]  # the plate comes first
        assert section is not None
        terms: Sequence[Local] = []
        for effect, own in pairs:
            terms = effect.attached(self.mesh, terms, own)
        damping = [part for effect, own in pairs if (part := effect.proportional(own)) is not None]
        added = [one for effect, own in pairs if (one := effect.added_mass(self.mesh, geometry, own)) is not None]
        return Plan(section, geometry, list(terms), damping, added)

    def system(self, theta: Float[Tensor, "*batch n_parameter"]) -> System:
        """Mass, stiffness and damping; what no searched parameter touches has no batch dimension."""
        return self.assembly.system(*self.plan(theta))

    def _theta(self, given: Numbers, check: bool) -> tuple[Tensor, bool]:
        """Theta in the model's precision, and whether results are wanted in single precision."""
        theta = as_theta(given, self.names, self.known)
        # To look is to wait for another device, which searches in a reduced basis do not do.
        if check and (theta.device.type == "cpu" or self.assembly.basis is None):
            check_range(theta, self.space, self._searched, self.limit)
        return theta, isinstance(given, Tensor) and given.dtype in (torch.float32, torch.float16, torch.bfloat16)

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
        theta: Numbers,
        frequency: Numbers,
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
                the lines cannot be meant.
        """
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

    # Called, a module runs `forward`.
    forward = frf

    def _points(
        self, response: Points | None, reference: Points | None, kind: str | None
    ) -> tuple[Tensor, Tensor | None, str]:
        kind = kind or self.kind
        if kind not in KINDS:
            raise ValueError(f"Expected kind to be one of {', '.join(KINDS)}, got '{kind}'.")
        found: list[Tensor | None] = []
        for name, given, own in (
            ("response", response, self.response),
            ("reference", reference, self.reference),
        ):
            points = own if given is None else given
            if points is None and not (name == "reference" and kind == "transmissibility"):
                raise ValueError(f"Expected a {name}, got none, and the model has no measurement. Give {name}=[node].")
            if points is None:
                found.append(None)
                continue
            places = self.mesh.places(as_points(points, name))
            if given is not None and self.mesh.cut and not isinstance(points, Tensor) and not transformed():
                self.mesh.check_on_plate(places.tolist())
            found.append(places.to(self.known))
        assert found[0] is not None
        return found[0], found[1], kind

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
        self,
        theta: Tensor,
        plan: Plan,
        laplace: Tensor,
        response: Tensor,
        reference: Tensor | None,
        own: bool,
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

    def excitation(self, plan: Plan, reference: Tensor | None) -> Float[Tensor, "*batch n_reference n"]:
        """Rows of the forces; the base's unit acceleration loads the plate with its inertia."""
        if reference is not None:
            return self.assembly.rows(self.mesh.deflection_at(reference))
        load = self.assembly.translation_load(plan.section.areal_mass, plan.geometry)
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
        """Members that fit half of the memory with their matrices and modes, on a CPU at most as many as pay."""
        flat = theta.reshape(theta.shape[:-1].numel(), theta.shape[-1])
        fitting = self.memory // 2 // (8 * theta.element_size() * self.assembly.size**2)
        if self.shared_modes is not None:
            fitting = max(fitting, MEMBERS_AT_ONCE)
        if theta.device.type == "cpu":
            fitting = min(fitting, MEMBERS_AT_ONCE)
        # A power of two, so that a member has the same place in its chunk if the batch is parted at one.
        return iter(flat.split(1 << max(0, fitting.bit_length() - 1)))
