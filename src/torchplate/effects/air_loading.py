"""The air on both sides of a plate, which moves with it."""

from dataclasses import dataclass

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative
from torchplate.plate import AddedMass, Geometry, Mesh, dragged


@dataclass(frozen=True)
class AirLoading(Effect):
    """M gains ρ_air A, the added mass of the fluid on both sides of an unbaffled plate; nothing is radiated.

    A field of wavenumber k drags 2 ρ_air / k along per area, less near the edges, where the air flows around them: so
    low modes and light plates feel it most, by 0.1 to 3 % of a natural frequency, and it is no density. A is found once
    for the nominal sides, by a lattice of doublets, and goes with the cube of the plate's size where the sides change.
    """

    parameters = {
        "density": Parameter(
            "kg/m³",
            "of the air on both sides",
            nonnegative,
            neutral=0.0,
            # Known beforehand: from a warm room at 500 m to a cold one at the sea.
            prior=Prior(1.1, 1.3, logarithmic=True),
        )
    }
    check = Check(2, "it is known to be there: 1.2 kg/m³ in a room; a plate in vacuum, or one twice as thick, parts it")
    acts_on = frozenset({"mass"})
    shows = "Lowers the lowest bending modes most and high ones less, and light plates more than heavy ones."
    source = "Lamb, Hydrodynamics (1932); Lan, J. Aircraft 11 (1974) 518; Amabili, J. Fluids Struct. 10 (1996) 743"

    def added_mass(self, mesh: Mesh, geometry: Geometry, value: Value) -> AddedMass:
        """The air's, for the mesh's sides, scaled to the plate's."""
        size = geometry.length_x * geometry.length_y / (mesh.length_x * mesh.length_y)
        return AddedMass(value["density"] * size**1.5, *dragged(mesh))
