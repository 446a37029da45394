"""What an effect is, and the catalogue of them.

An effect is declared like a table, data first, then one formula. It has eight possible words: `discretise`, `geometry`,
`section`, `local`, `attached`, `added_mass`, `proportional` and `observe`. It never builds a whole matrix, so the same
effect serves the dense population, the fine mesh and the reduced basis. A class body that inherits from Effect enters
the catalogue by itself.
"""

import dataclasses
import re
from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from jaxtyping import Bool, Complex, Float, Int
from torch import Tensor

from torchplate.effects.parameter import Parameter
from torchplate.nearest import did_you_mean
from torchplate.plate import AddedMass, Geometry, Local, Mesh, Proportional, Section

Value = Mapping[str, Tensor]
Point = int | Sequence[float]
# [response, reference], None for all of them; or the label of a response, or of a reference if no response has it.
Channel = int | tuple[Point | None, Point | None]
# A channel is known by the place its label stands for, to this part of an element of the labelled grid.
NEAR = 0.25


class SensorChain(NamedTuple):
    """How motion becomes a reading: where the responses sit, at which s the record is transformed, what it is times.

    The reading is factor(s) · H(s), evaluated at s = iω where nothing disturbs it. A sensor that weighs something loads
    its own records: H is then that of the plate with the mass at this response, and at no other.
    """

    laplace: Complex[Tensor, "*batch n_frequency"]  # s [1/s]
    response: Float[Tensor, "*batch n_response 2"]  # relative places where the sensors sit [-]
    factor: Complex[Tensor, "*batch n_frequency n_response n_reference"]  # [-]
    response_label: Float[Tensor, "n_response 2"]  # relative places that the labels stand for [-]
    reference_label: Float[Tensor, "n_reference 2"] | None  # likewise; None where the base moves
    # Which FRF, counted along the references first, is read under each label; None for its own.
    reading: Int[Tensor, "n_response n_reference"] | None = None
    # What moves with the plate at each record's own response [kg]; None where nothing does.
    mass: Float[Tensor, "*batch n_response"] | None = None

    def at_response(self, mesh: Mesh, point: Point) -> Bool[Tensor, " n_response"]:
        """Which responses carry the label of a node or place; none if it is not among them."""
        return _labelled(mesh, self.response_label, point)

    def in_channel(self, mesh: Mesh, channel: Channel) -> Bool[Tensor, "n_response n_reference"]:
        """Which FRFs a channel names; none if it is not among them.

        Raises:
            ValueError: if a label is not on the grid, or a place is not on the plate.
        """
        every = torch.ones(self.factor.shape[-2:], dtype=torch.bool, device=self.factor.device)
        sides: tuple[Point | None, Point | None] = (channel, None) if isinstance(channel, int) else channel
        response, reference = (
            every.any(along) if point is None else _labelled(mesh, label, point).to(every.device)
            for point, label, along in zip(sides, (self.response_label, self.reference_label), (1, 0), strict=True)
        )
        if isinstance(channel, int):
            of_reference = _labelled(mesh, self.reference_label, channel).to(every.device)
            return response[:, None] & every | ~response.any() & of_reference & every
        return response[:, None] & reference & every


def _labelled(mesh: Mesh, label: Float[Tensor, "n_point 2"] | None, point: Point) -> Bool[Tensor, " n_found"]:
    """Which of the labelled places is the nearest to a point and near it; none of the base's one."""
    place = mesh.places([point])
    if label is None:
        return place.new_zeros(1).bool()
    grid = place.new_tensor([mesh.n_x, mesh.n_y])
    distance = ((label.detach().to(place) - place) * grid).abs().amax(-1)
    return (distance <= NEAR) & (distance <= distance.amin() + 1e-9)


class Check(NamedTuple):
    """The cheapest measurement that tells an effect from those that look like it.

    Attributes:
        cost: 1 for a look or a ruler, 5 for another specimen.
        action: what to do, for a person.
    """

    cost: int
    action: str


CATALOGUE: dict[str, type["Effect"]] = {}


@dataclass(frozen=True)
class Effect(ABC):
    """One physical effect; fields of a subclass are its fixed options (nodes, an edge), never searched.

    Effects of a lower `stage` act first, those of one stage in the order of the config: 0 the plate, 1 what replaces a
    number of the plate, 2 the most, 3 what changes what others have brought.

    An effect whose parameters depend on its options sets `parameters` on the instance too; those of the class are then
    an example.

    `to_ground` is the parameter by which an effect at a place (x, y) ties the plate to the ground there, as a support
    would; None for all other effects.

    `contains` names simpler effects that it becomes at an end of its parameters: they are tried first, and it only
    where they leave something.

    `like` names what every test has a little of and that looks like it: a law of damping is like the scatter of the
    modes' own dampings. Where a test would need far more of that than tests have, the effect is tried.

    `jumps` says that the plate's moments jump across it wherever it lies, between lines of the mesh too: what a mesh
    leaves is then of the first order in a side, and of the second elsewhere.
    """

    name: ClassVar[str]
    parameters: ClassVar[Mapping[str, Parameter]]
    acts_on: ClassVar[frozenset[str]]
    shows: ClassVar[str]
    source: ClassVar[str]
    stage: ClassVar[int] = 2
    check: ClassVar[Check | None] = None
    to_ground: ClassVar[str | None] = None
    contains: ClassVar[tuple[str, ...]] = ()
    like: ClassVar[frozenset[str]] = frozenset()
    jumps: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        """Enter the catalogue under the class's name in snake case."""
        cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()
        for word in ("parameters", "acts_on", "shows", "source"):
            if word not in vars(cls):
                raise TypeError(f"The effect '{cls.name}' says nothing of its {word}. Add it to the class body.")
        CATALOGUE[cls.name] = cls

    @classmethod
    def moves_natural_frequencies(cls) -> bool:
        """Whether undamped natural frequencies can see it: they see no damping and no sensor chain.

        It follows from `acts_on`; a class body for which that is not so says it itself.
        """
        return bool(cls.acts_on & {"mass", "stiffness", "geometry"}) or (
            "section" in cls.acts_on and "damping" not in cls.acts_on
        )

    @classmethod
    def may_be_missing(cls, section: Section) -> bool:  # noqa: ARG003  # of a class body that says more
        """Whether a search for what a model lacks is to look for it on a plate of this section.

        It is, if such a search knows where to look: one of its parameters has a prior, or it has none. A class body
        says more where a plate may be such that the effect changes nothing.
        """
        return not cls.parameters or any(parameter.prior is not None for parameter in cls.parameters.values())

    def discretise(self, mesh: Mesh) -> Mesh:
        """The mesh as this effect changes it."""
        return mesh

    def geometry(self, geometry: Geometry, value: Value) -> Geometry:
        """The plate's sides as this effect changes them."""
        return geometry

    def section(self, mesh: Mesh, section: Section, value: Value) -> Section:
        """The elements' section as this effect changes it."""
        return section

    def local(self, mesh: Mesh, value: Value) -> Local | None:
        """Masses, springs and dashpots that this effect adds at places."""
        return None

    def n_row(self, mesh: Mesh) -> int:
        """Rows over the dofs of a mesh that `local` makes for each member at most; one, but along a line [-]."""
        return 1

    def attached(self, mesh: Mesh, terms: Sequence[Local], value: Value) -> Sequence[Local]:
        """The terms of the effects before it, with its own; or changed, if it changes what is attached already."""
        own = self.local(mesh, value)
        return terms if own is None else [*terms, own]

    def added_mass(self, mesh: Mesh, geometry: Geometry, value: Value) -> AddedMass | None:
        """Mass that this effect spreads over the whole plate, and that couples the motion of its parts."""
        return None

    def proportional(self, value: Value) -> Proportional | None:
        """Damping in proportion to the whole model that this effect adds."""
        return None

    def observe(self, mesh: Mesh, chain: SensorChain, value: Value, geometry: Geometry) -> SensorChain:
        """The sensor chain as this effect changes it."""
        return chain


def find_effect(name: str) -> type[Effect]:
    """The effect of that name.

    Raises:
        KeyError: if the catalogue holds none, with the nearest name.
    """
    if name not in CATALOGUE:
        raise KeyError(
            f"No effect named '{name}'.{did_you_mean(name, CATALOGUE)} The catalogue holds: {', '.join(CATALOGUE)}."
        )
    return CATALOGUE[name]


def options(effect: type[Effect]) -> tuple[str, ...]:
    """Names of an effect's fixed options."""
    return tuple(field.name for field in dataclasses.fields(effect))
