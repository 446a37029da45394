"""A rectangular patch of another bending stiffness, or without plate, and the elements that its edges cut.

The curvatures of an element are not the same all over it, and a patch that covers half of one sees those of that half.
What `laminate` makes of a cut element is right for curvatures that are the same everywhere; beside it stands here how
the bending goes over the element. Both together are exact to first order in how much weaker the patch is, and of two
strips one after the other, under moments that are linear along them, exact altogether.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Inexact
from torch import Tensor

from torchplate.plate.laminate import laminate
from torchplate.plate.mesh import Mesh
from torchplate.plate.section import Section
from torchplate.plate.transforms import transformed

# Powers of a relative place, 0 to 4: curvatures have squares in them, the twist of an element among them; and 0 to 6,
# since deflections have cubes.
BENT, MOVED = 5, 7
# Part of the mass of an element cut by a hole that lies evenly over it [-]. A sliver, of a part ε, then has natural
# frequencies up to 36 / 0.37 EVENLY, and down to 84 ε² / EVENLY, both over D / ρh and the fourth power of a side; by
# what stiffness is left in a hole, the latter are not below 8, where waves of eight elements have 0.38.
EVENLY = 2e-3
# The same over a whole side, from its middle.
WHOLE = torch.tensor([1.0, 0.0, 1 / 12, 0.0, 1 / 80], dtype=torch.float64)


def patched(
    section: Section,
    mesh: Mesh,
    factor: Inexact[Tensor, "*#batch"],
    x: Float[Tensor, "*#batch"],
    y: Float[Tensor, "*#batch"],
    size: Float[Tensor, "*#batch"],
    aspect: Float[Tensor, "*#batch"] | float = 1.0,
) -> Section:
    """What each element is made of with a patch on it.

    Args:
        section: without it.
        mesh: the mesh.
        factor: bending stiffness under the patch over that beside it [-]; complex where it dissipates.
        x: its centre along x, relative [-].
        y: along y.
        size: root of its area over √(Lx Ly) [-]; see `Mesh.coverage`.
        aspect: its side along x over that along y, in metres [-].
    """
    outline = mesh.outline(x, y, size, aspect)
    mean = laminate(factor[..., None], *mesh.overlap(*outline), section.poisson_ratio)
    uneven = uneven_bending(mesh, *outline, factor, section.poisson_ratio) * section.stiffness_factor[..., None]
    cut = None if section.uneven_density is None else section.uneven_density.ne(0).any(-1)[..., None, None]
    if not factor.is_complex():
        return section._replace(
            stiffness_factor=section.stiffness_factor * mean,
            uneven=_over(cut, section.uneven, mean, uneven),
        )
    return section._replace(
        stiffness_factor=section.stiffness_factor * mean.real,
        loss_factor=_sum(section.loss_factor, mean.imag / mean.real),
        uneven=_over(cut, section.uneven, mean.real, uneven.real),
        uneven_loss=_over(cut, section.uneven_loss, mean.real, uneven.imag),
    )


def with_hole(
    section: Section,
    mesh: Mesh,
    over_x: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
    over_y: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
    left: tuple[float, float],
) -> Section:
    """What each element is made of with a rectangle without plate.

    Of an element that an edge cuts, bending and mass are those of what is there, which moves as the whole element does:
    nothing holds it at the edge. Two thousandths of that mass lie evenly over the element: a sliver that is left of one
    would else have no mass to speak of where it is stiff, and its frequency would cost the others their digits.

    Args:
        section: without it.
        mesh: the mesh.
        over_x: from where to where the rectangle goes along x, relative [-].
        over_y: along y.
        left: stiffness and mass in it over those beside it [-].

    Source: the finite cell method, Parvizian, Düster and Rank, Computational Mechanics 41 (2007), 121.
    """
    covered = [_covered(over, n, MOVED) for over, n in zip((over_x, over_y), mesh.cells, strict=True)]
    every = mesh.of_kept_elements(_products(*covered), -3)
    inside = every[..., 0, 0]
    # By the same sums, so that nothing but what is left is left of an element that is inside: not even rounding.
    whole = _powers(inside.new_tensor(-0.5), inside.new_tensor(0.5), MOVED)
    stiffness, mass = (1 - (1 - part) * inside for part in left)
    uneven = every - inside[..., None, None] * whole[:, None] * whole
    bent = (left[0] - 1) * uneven[..., :BENT, :BENT].flatten(-2)[..., None, :]
    bent = bent * section.stiffness_factor.expand(*section.stiffness_factor.shape[:-1], 4)[..., None]
    heavy = (1 - EVENLY) * (left[1] - 1) * uneven.flatten(-2) * section.density[..., None]
    cut = None if section.uneven is None else section.uneven.ne(0).any(-1).any(-1)[..., None, None]
    heavy_cut = None if section.uneven_density is None else section.uneven_density.ne(0).any(-1, keepdim=True)
    found = section._replace(
        stiffness_factor=section.stiffness_factor * stiffness[..., None],
        density=section.density * mass,
        uneven=_over(cut, section.uneven, stiffness[..., None], bent),
        uneven_density=_over(heavy_cut, section.uneven_density, mass, heavy),
    )
    if section.loss_factor is None:
        return found
    lost = bent * section.loss_factor[..., None]
    return found._replace(uneven_loss=_over(cut, section.uneven_loss, stiffness[..., None], lost))


def _over(cut: Tensor | None, before: Tensor | None, factor: Tensor, more: Tensor) -> Tensor:
    """How two things go over an element: one after the other; where the first cuts it, the second as its mean.

    Twice nothing is nothing, and a sum of both would be less.

    Args:
        cut: where the first one cuts elements; None where there is no hole in it.
        before: how that goes over elements; None where it does not.
        factor: mean of the second one.
        more: how that goes over elements.
    """
    if cut is None:
        return _sum(before, more)
    return torch.where(cut, 0.0 if before is None else before * factor[..., None], _sum(before, more))


def _sum(one: Tensor | None, other: Tensor) -> Tensor:
    return other if one is None else one + other


def uneven_bending(
    mesh: Mesh,
    over_x: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
    over_y: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
    factor: Inexact[Tensor, "*#batch"],
    poisson_ratio: Float[Tensor, "*#batch #n_element"],
) -> Inexact[Tensor, "*batch n_element 4 25"]:
    """∫ (D/D₀ − mean) ξ^p η^q over each element, D₁₁, D₂₂, D₁₂ and D₃₃ over the sound ones D₀, at 5p + q [-].

    ξ and η go from the middle of an element, in its sides. A patch ends at the edge of the plate.

    Args:
        mesh: the mesh.
        over_x: from where to where the patch goes along x, relative [-].
        over_y: along y.
        factor: bending stiffness under the patch over the sound one [-]; complex where it dissipates.
        poisson_ratio: √(ν_x ν_y).

    Source: of two strips one after the other the flexibility ∫ MᵀM / D, inverted (Przemieniecki, Theory of Matrix
    Structural Analysis, 1968, chapter 6), for M_x = D (κ_x + ν κ_y); beside each other they are bent alike.
    """
    strips = [_strips(over, n, factor) for over, n in zip((over_x, over_y), mesh.cells, strict=True)]
    # Elements that no member's patch reaches are left out, and are zero: a patch is small.
    alike = poisson_ratio.shape[-1] == 1
    near = [_reached(part) if alike else slice(None) for part, _, _ in strips]
    (part_x, series_x, beside_x), (part_y, series_y, beside_y) = (
        [one[..., some, :] for one in strip] for strip, some in zip(strips, near, strict=True)
    )
    nu = poisson_ratio.square()[..., None, None]
    # Where both sides are cut, half of each is taken before the other and half after it.
    series, beside = _products(series_x, part_y), _products(beside_x, part_y)
    turned, aside = _products(part_x, series_y), _products(part_x, beside_y)
    found = (
        series + nu * turned + (1 - nu) * aside,
        turned + nu * series + (1 - nu) * beside,
        series + turned,
        beside + aside,
    )
    some = torch.stack(found, dim=-3).flatten(-2)
    return mesh.of_kept_elements(_among(some, near, mesh.cells), -3)


def _reached(part: Tensor) -> slice:
    """Rows of elements from the first to the last that some member's strip covers; all of them where nobody may look.

    What is zero here and has a derivative does not stay zero.
    """
    if part.requires_grad or transformed():
        return slice(None)
    rows = torch.nonzero(part[..., 0].reshape(-1, part.shape[-2]).abs().sum(0)).flatten()
    return slice(int(rows[0]), int(rows[-1]) + 1) if len(rows) else slice(0, 0)


def _among(
    value: Inexact[Tensor, "*batch n_some n_entry n_power"], near: Sequence[slice], cells: tuple[int, int]
) -> Inexact[Tensor, "*batch n_element n_entry n_power"]:
    """Values of the elements in some columns and rows, zero in the others."""
    (first_x, last_x, _), (first_y, last_y, _) = (some.indices(n) for some, n in zip(near, cells, strict=True))
    if (last_x - first_x, last_y - first_y) == cells:
        return value
    found = value.new_zeros(*value.shape[:-3], cells[1], cells[0], *value.shape[-2:])
    found[..., first_y:last_y, first_x:last_x, :, :] = value.unflatten(-3, (last_y - first_y, last_x - first_x))
    return found.flatten(-4, -3)


def _products(along_x: Tensor, along_y: Tensor) -> Inexact[Tensor, "*batch n_place n_power n_power"]:
    """Products of what goes along x and along y, places counted along x first."""
    return (along_y[..., :, None, None, :] * along_x[..., None, :, :, None]).flatten(-4, -3)


def _covered(over: tuple[Tensor, Tensor], n: int, n_power: int) -> Float[Tensor, "*batch n n_power"]:
    """∫ ξ^p over what a strip covers of each row of elements, ξ from the middle of an element."""
    number = torch.arange(n, dtype=over[0].dtype, device=over[0].device)
    low, high = ((end[..., None] * n - number).clamp(0, 1) - 0.5 for end in over)
    return _powers(low, high, n_power)


def _powers(low: Float[Tensor, "*any"], high: Float[Tensor, "*any"], n_power: int) -> Float[Tensor, "*any n_power"]:
    """∫ ξ^p from one place to another."""
    power = torch.arange(1, n_power + 1, device=low.device)
    return (high[..., None] ** power - low[..., None] ** power) / power


def _strips(
    over: tuple[Tensor, Tensor], n: int, factor: Tensor
) -> tuple[Tensor, Inexact[Tensor, "*batch n 5"], Inexact[Tensor, "*batch n 5"]]:
    """Of each row of elements: what is covered, and what is uneven across the cut and along it.

    The first is the mean of what is covered and of what a mean would be, over all powers.
    """
    covered = _covered(over, n, BENT)
    whole = WHOLE.to(covered)
    part = covered[..., :1]
    beside = (factor[..., None, None] - 1) * (covered - part * whole)
    weaker = factor[..., None].reciprocal() - 1
    one, first, second = (weaker * covered[..., k] for k in range(3))
    one, second = 1 + one, 1 / 12 + second
    left = one * second - first.square()
    # In the curvature at the middle and its slope, of which a slope of 1 turns by 1/12.
    series = [second / left - 1 / one, -first / left / 12, one / left / 144 - 1 / one / 12]
    # A twist has higher powers, with which that of a turned grain bends.
    series = [*series, *beside.unbind(-1)[3:]]
    return 0.5 * (covered + part * whole), torch.stack(series, dim=-1), beside
