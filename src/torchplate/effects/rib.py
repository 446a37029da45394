"""A stiffener along a line: a bead, a brace, a strip that was glued or welded on."""

import functools
import math
from dataclasses import dataclass

import torch

from torchplate.effects.effect import Check, Effect, Value
from torchplate.effects.parameter import Parameter, Prior, nonnegative, unit_interval
from torchplate.plate import Local, Mesh

# Gauss points on 0 to 1, two to a piece.
POINT = torch.tensor([0.5 - math.sqrt(1 / 12), 0.5 + math.sqrt(1 / 12)], dtype=torch.float64)
# A rib of no length points along x [m].
TINY = 1e-12


@dataclass(frozen=True)
class Rib(Effect):
    """A beam that bends and turns with the plate along a straight line, at any angle.

    Energy ½ ∫ (EI w,ss² + GJ w,sn²) ds and ½ ∫ m ẇ² ds along the line s, n across it. The rib is a chain of cubic
    beam elements, each about as long as an element of the mesh, whose ends have the plate's deflection w and slopes
    w,s and w,n: of a piece of length l, K gains the rank-one terms EI/l (Δw,s)², 12 EI/l (Δw/l − mean w,s)² and
    GJ/l (Δw,n)². The curvature of the plate's own shape functions would not do: their slopes jump from element to
    element, where a rib would then bend for nothing. Near an edge its ends have the motion of both elements. EI is
    about the axis that the plate and the rib bend about together: of a rib on one side give EI with its Steiner part
    about that axis, since the plate's membrane is not modelled. Lengths are those of the nominal plate.
    """

    parameters = {
        "x0": Parameter("-", "one end along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y0": Parameter("-", "one end along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "x1": Parameter("-", "other end along x, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "y1": Parameter("-", "other end along y, relative to the plate", unit_interval, prior=Prior(0.0, 1.0)),
        "bending": Parameter(
            "N m²",
            "EI of the rib, about the axis it bends about with the plate",
            nonnegative,
            neutral=0.0,
            prior=Prior(0.0, 2.0, relative_to="plate"),
        ),
        "torsion": Parameter(
            "N m²", "GJ of the rib", nonnegative, neutral=0.0, prior=Prior(0.0, 2.0, relative_to="plate")
        ),
        "mass_per_length": Parameter(
            "kg/m", "of the rib", nonnegative, neutral=0.0, prior=Prior(0.0, 0.2, relative_to="plate")
        ),
    }
    check = Check(1, "look at both sides for a bead, a brace or a glued strip, and measure its ends")
    acts_on = frozenset({"mass", "stiffness"})
    # Its torsion is a couple along its line, where the plate's curvature then jumps inside of elements.
    jumps = True
    shows = "Lifts the modes that bend or twist along one line and lowers those that merely move there."
    source = "Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells (1959), article 84, plates with ribs"

    def local(self, mesh: Mesh, value: Value) -> Local:
        """Bending and torsion of each piece between two stations, and the deflection at its Gauss points."""
        ends = torch.stack(torch.broadcast_tensors(*(value[name] for name in ("x0", "y0", "x1", "y1"))), dim=-1)
        first, last = ends[..., None, :2], ends[..., None, 2:]
        sides = ends.new_tensor([mesh.length_x, mesh.length_y])
        way = (last - first) * sides + sides.new_tensor([TINY, 0.0])
        length = way.square().sum(-1, keepdim=True).sqrt()
        direction = way / length
        piece = (direction * sides / sides.new_tensor(mesh.cells)).square().sum(-1, keepdim=True).sqrt()
        n = most_pieces(mesh)
        number = torch.arange(n + 1).to(ends)[:, None]
        station = first + number * piece * direction / sides
        cos, sin = direction.split(1, dim=-1)
        dof, (deflection, *slopes) = mesh.shapes_about(station, (0, 0), (1, 0), (0, 1))
        along_x, along_y = (one / side for one, side in zip(slopes, sides, strict=True))
        slope, turn = cos * along_x + sin * along_y, cos * along_y - sin * along_x
        here, there = (
            [one[..., index, :] for one in (deflection, slope, turn)] for index in (slice(-1), slice(1, None))
        )
        bent, turned = (torch.cat([-before, after], dim=-1) for before, after in zip(here[1:], there[1:], strict=True))
        sheared = torch.cat([-here[0] / piece - 0.5 * here[1], there[0] / piece - 0.5 * there[1]], dim=-1)
        # The last piece counts as far as the rib goes, and one that ends inside a hole not at all.
        on_plate = (deflection != 0).any(-1)
        part = (length / piece - number[:-1]).clamp(0.0, 1.0)[..., 0] * on_plate[..., :-1] * on_plate[..., 1:]
        at = number[:-1] + POINT.to(ends) * part[..., None]
        gauss = first[..., None, :] + at[..., None] * (piece * direction / sides)[..., None, :]
        per_length, whole = part / piece[..., 0], part * piece[..., 0]
        bending, torsion, heavy = (value[name][..., None] for name in ("bending", "torsion", "mass_per_length"))
        kinds = torch.broadcast_tensors(
            bending * per_length, 12 * bending * per_length, torsion * per_length, 0.5 * heavy * whole
        )
        nothing = torch.zeros_like(kinds[0])
        heavy = kinds[3].repeat_interleave(2, dim=-1)
        moved_dof, (moved,) = mesh.shapes_about(gauss.flatten(-3, -2), (0, 0))
        ends_dof = torch.cat([dof[..., :-1, :], dof[..., 1:, :]], dim=-1)
        which = torch.cat([ends_dof, ends_dof, ends_dof, torch.cat([moved_dof, moved_dof], dim=-1)], dim=-2)
        rest = bent.shape[-1] - moved.shape[-1]
        row = torch.cat([bent, sheared, turned, torch.nn.functional.pad(moved, (0, rest))], dim=-2)
        return Local(
            # Of the dofs of a mesh few move a piece.
            row.new_zeros(*row.shape[:-1], mesh.n_dof).scatter_add_(-1, which, row),
            mass=torch.cat([nothing, nothing, nothing, heavy], dim=-1),
            stiffness=torch.cat([*kinds[:3], nothing, nothing], dim=-1),
        )

    def n_row(self, mesh: Mesh) -> int:
        """Three of each piece between two stations, and one of each Gauss point."""
        return 5 * most_pieces(mesh)


def most_pieces(mesh: Mesh) -> int:
    """Pieces of the longest rib that the plate has room for."""
    return _most_pieces((mesh.length_x, mesh.length_y), mesh.cells)


@functools.lru_cache(maxsize=64)
def _most_pieces(sides: tuple[float, float], cells: tuple[int, int]) -> int:
    """The same of a plate of these sides [m], for each member that asks."""
    share = torch.linspace(0, 1, 41, dtype=torch.float64)
    whole = torch.tensor(sides, dtype=torch.float64)
    way = torch.cartesian_prod(share, share)[1:] * whole
    side = whole / torch.tensor(cells, dtype=torch.float64)
    return math.ceil(float((way.square().sum(-1) / (way * side).norm(dim=-1)).max()) - 1e-9)
