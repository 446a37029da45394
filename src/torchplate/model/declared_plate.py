"""A plate as it is declared: its effects, what of their parameters is known and searched, its channels."""

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchplate.effects import Effect, Plate, Searched
from torchplate.model.arguments import Numbers, Point, Points, as_points, as_theta, check_range, limits
from torchplate.model.declared import check_rigid, declared
from torchplate.model.off_marks import OffMarks, carried_masses
from torchplate.model.receptance.frf import KINDS, laplace_lines, sensor_chain
from torchplate.model.receptance.shared_modes import SharedModes
from torchplate.plate import Assembly, Geometry, Local, Mesh, Plan, Section, transformed


class DeclaredPlate(nn.Module):
    """What a `PlateModel` takes, and what its effects make of a theta; nothing is solved here."""

    known: Tensor
    limit: Tensor

    def __init__(
        self,
        mesh: Mesh,
        effects: Mapping[str, Effect],
        known: Mapping[str, float],
        searched: Mapping[str, Searched] | None = None,
        response: Points | None = None,
        reference: Points | None = None,
        kind: str = "receptance",
        memory: int = 2**30,
        assembly: Assembly | None = None,
    ) -> None:
        super().__init__()
        self.effects = dict(effects)
        self.response, self.reference = _own_points(response, "response"), _own_points(reference, "reference")
        self.kind, self.memory = kind, memory
        if sum(isinstance(effect, Plate) for effect in self.effects.values()) != 1:
            raise ValueError("Expected exactly one effect `plate` in the model, got none or several. Keep one.")
        # The plate comes first and what changes other effects last, whatever their order in a config.
        self.effects = dict(sorted(self.effects.items(), key=lambda item: item[1].stage))
        for effect in self.effects.values():
            mesh = effect.discretise(mesh)
        for points in (self.response, self.reference):
            if mesh.cut and points is not None:
                mesh.check_on_plate(mesh.places(points).tolist())
        self.mesh = mesh
        found = declared(self.effects, known, searched or {})
        check_rigid(mesh, self.effects, found)
        values, self._searched, self.space = found
        self.register_buffer("known", torch.tensor(values, dtype=torch.float64))
        self.register_buffer("limit", limits(self.space, self._searched), persistent=False)
        self.assembly = Assembly(mesh) if assembly is None else assembly
        self._own_places: dict[str, tuple[Mesh, tuple[object, ...], Tensor]] = {}
        self.shared_modes: SharedModes | None = None
        self.couples_modes, self.in_single = True, False
        self.damping_factor: Tensor | None = None
        self.section_off: Callable[[Mesh, Section], Section] | None = None
        self.off_marks: OffMarks | None = None
        # Made now, because what is first made inside a torch.func transform belongs to that transform.
        for name, member in vars(Mesh).items():
            if isinstance(member, functools.cached_property):
                getattr(mesh, name)
        # Nobody is asked for channels yet; a place that is none is near no label.
        nowhere = self.known.new_full((1, 2), math.nan)
        self._check_effects(nowhere, nowhere)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> "DeclaredPlate":
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

    def extra_repr(self) -> str:
        """One line for `print(model)`."""
        return (
            f"effects={list(self.effects)}, searched={list(self.names)}, n_dof={self.assembly.size}, kind={self.kind}"
        )

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
        if self.section_off is not None:
            section = self.section_off(self.mesh, section)
        terms: Sequence[Local] = []
        for effect, own in pairs:
            terms = effect.attached(self.mesh, terms, own)
        if self.off_marks is not None:
            terms = self.off_marks.supported(self.mesh, self.effects, terms)
        damping = [part for effect, own in pairs if (part := effect.proportional(own)) is not None]
        added = [one for effect, own in pairs if (one := effect.added_mass(self.mesh, geometry, own)) is not None]
        section = section.passive(sum((part.stiffness_loss_factor for part in damping), 0.0))
        return Plan(section, geometry, list(terms), damping, added)

    def carried(self) -> dict[str, int]:
        """Labels of the point masses that are a sensor's own, and which of the model's own responses that is."""
        return carried_masses(self.effects, self.known_values, self._points(None, None, None)[0])

    def read_from(self) -> tuple[Tensor, Tensor]:
        """Which of the model's own responses and references is read under each label: others where two are exchanged.

        Where single FRFs are exchanged, and not all of a channel, each is taken for its own.
        """
        response, reference, _ = self._points(None, None, None)
        chain = sensor_chain(laplace_lines(self.known.new_ones(1), 0.0), response, reference)
        for effect in self.effects.values():
            if not effect.parameters and "sensor chain" in effect.acts_on:
                chain = effect.observe(self.mesh, chain, {}, self._nominal())
        n_response, n_reference = chain.factor.shape[-2:]
        own = torch.arange(n_response, device=self.known.device), torch.arange(n_reference, device=self.known.device)
        if chain.reading is None:
            return own
        row, column = chain.reading // n_reference, chain.reading % n_reference
        return (
            row[:, 0] if bool((row == row[:, :1]).all()) else own[0],
            column[0] if bool((column == column[:1]).all()) else own[1],
        )

    def _points(
        self, response: Points | None, reference: Points | None, kind: str | None
    ) -> tuple[Tensor, Tensor | None, str]:
        kind = kind or self.kind
        if kind not in KINDS:
            raise ValueError(f"Expected kind to be one of {', '.join(KINDS)}, got '{kind}'.")
        found: list[Tensor | None] = []
        for name, given, own in (("response", response, self.response), ("reference", reference, self.reference)):
            points = own if given is None else given
            if points is None and not (name == "reference" and kind == "transmissibility"):
                raise ValueError(f"Expected a {name}, got none, and the model has no measurement. Give {name}=[node].")
            if points is None:
                found.append(None)
                continue
            places = self._known_places(name, points) if given is None else self.mesh.places(as_points(points, name))
            if given is not None and self.mesh.cut and not isinstance(points, Tensor) and not transformed():
                self.mesh.check_on_plate(places.tolist())
            found.append(places.to(self.known))
        assert found[0] is not None
        return found[0], found[1], kind

    def _known_places(self, name: str, points: Points) -> Tensor:
        """The places of the model's own points, those of before where these are the same: each FRF asks for them."""
        points = as_points(points, name)
        if isinstance(points, Tensor):
            return self.mesh.places(points)
        key = tuple(point if isinstance(point, int) else tuple(point) for point in points)
        known = self._own_places.get(name)
        if known is None or known[0] is not self.mesh or known[1] != key:
            known = self.mesh, key, self.mesh.places(points)
            if not transformed() and not torch.is_inference_mode_enabled():
                self._own_places[name] = known
        return known[2]

    def _theta(self, given: Numbers, check: bool) -> tuple[Tensor, bool]:
        """Theta in the model's precision, and whether results are wanted in single precision."""
        theta = as_theta(given, self.names, self.known)
        # To look is to wait for another device, which searches in a reduced basis do not do.
        if check and (theta.device.type == "cpu" or self.assembly.basis is None):
            check_range(theta, self.space, self._searched, self.limit)
        return theta, isinstance(given, Tensor) and given.dtype in (torch.float32, torch.float16, torch.bfloat16)


def _own_points(given: Points | None, name: str) -> Sequence[Point] | None:
    """A model's own points, which are data: numbers in a list, whatever they were given as."""
    points = None if given is None else as_points(given, name)
    return points.tolist() if isinstance(points, Tensor) else points
