"""The 12-dof Kirchhoff–Love rectangle with four corners and three dofs at each.

The deflection is the polynomial with the terms 1, x, y, x², xy, y², x³, x²y, xy², y³, x³y, xy³ (seed paper, Eq. 6–8;
Zienkiewicz and Cheung 1964, Melosh 1963). Corners go round from (0, 0): (0, 0), (a, 0), (a, b), (0, b). The dofs of a
corner are w, tx = dw/dy and ty = −dw/dx.

Every integral is exact: monomials integrate over the unit square in closed form, and the sides enter as powers.
"""

from functools import cache, lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

N_DOF = 12
EXPONENT = torch.tensor(
    [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (3, 1), (1, 3)]
)
CORNER = torch.tensor([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], dtype=torch.float64)

# Shapes of elements whose patterns are kept, of 240 kB each; what is made in inference mode would have no gradients.
MOST_KNOWN = 32

# The six independent entries of a symmetric 3 × 3 rigidity, in the order the patterns below are stored.
RIGIDITY_ROW = (0, 1, 2, 0, 0, 1)
RIGIDITY_COLUMN = (0, 1, 2, 1, 2, 2)


class Patterns(NamedTuple):
    """Element matrices per unit of what they integrate, for one pair of sides.

    The stiffness of an element is Σ rigidity[i, j] · stiffness[k] over the six entries (i, j) of `RIGIDITY_ROW`,
    `RIGIDITY_COLUMN`; its mass is areal mass · mass.
    """

    stiffness: Float[Tensor, "6 12 12"]
    mass: Float[Tensor, "12 12"]


def monomials(place: Float[Tensor, "*batch 2"], order_x: int = 0, order_y: int = 0) -> Float[Tensor, "*batch 12"]:
    """Derivative ∂^(order_x + order_y) / ∂x^order_x ∂y^order_y of the twelve monomials [m^(power − order)]."""
    power_x, power_y = EXPONENT[:, 0].to(place.device), EXPONENT[:, 1].to(place.device)
    factor = _falling(power_x, order_x) * _falling(power_y, order_y)
    x, y = place[..., :1], place[..., 1:]
    return factor.to(place.dtype) * x ** (power_x - order_x).clamp(min=0) * y ** (power_y - order_y).clamp(min=0)


def shape_functions(
    place: Float[Tensor, "*batch 2"], a: float, b: float, order_x: int = 0, order_y: int = 0
) -> Float[Tensor, "*batch 12"]:
    """Shape functions N = R A⁻¹ of an a × b element, or a derivative of them (seed paper, Eq. 15–16).

    Args:
        place: relative place (x/a, y/b) in the element [-], each 0 to 1.
        a: side along x [m], > 0.
        b: side along y [m], > 0.
        order_x: order of the derivative in x.
        order_y: order of the derivative in y.

    Returns:
        What each dof (w, tx, ty at four corners) adds to the deflection, or to its derivative, at the place.
    """
    coefficient = _coefficients().to(place)
    scale = _dof_scale(a, b).to(place)
    return monomials(place, order_x, order_y) @ coefficient * scale / (a**order_x * b**order_y)


@lru_cache(MOST_KNOWN)
@torch.inference_mode(False)
def patterns(a: float, b: float) -> Patterns:
    """Exact ∫ Bᵀ D B and ∫ Nᵀ N over an a × b element, split by the entries of D (seed paper, Eq. 13–14).

    Args:
        a: side along x [m], > 0.
        b: side along y [m], > 0.
    """
    coefficient, scale = _coefficients(), _dof_scale(a, b)
    # Curvatures −w,xx, −w,yy, −2w,xy (Eq. 9), each a row of falling factors times a lowered monomial.
    orders = ((2, 0), (0, 2), (1, 1))
    side = (-1 / a**2, -1 / b**2, -2 / (a * b))
    strain = torch.stack([_moment(p, q) for p in orders for q in orders]).reshape(3, 3, N_DOF, N_DOF)
    weight = torch.tensor([[side[i] * side[j] for j in range(3)] for i in range(3)], dtype=torch.float64)
    full = weight[..., None, None] * (coefficient.mT @ strain @ coefficient) * scale[:, None] * scale * (a * b)
    row, column = list(RIGIDITY_ROW), list(RIGIDITY_COLUMN)
    stiffness = full[row, column]
    # An off-diagonal entry of D stands at two places of the sum.
    stiffness[3:] = stiffness[3:] + full[column, row][3:]
    mass = (coefficient.mT @ _moment((0, 0), (0, 0)) @ coefficient) * scale[:, None] * scale * (a * b)
    return Patterns(0.5 * (stiffness + stiffness.mT), 0.5 * (mass + mass.mT))


@lru_cache(MOST_KNOWN)
@torch.inference_mode(False)
def uneven_patterns(a: float, b: float) -> Float[Tensor, "6 25 12 12"]:
    """The same of stiffness, where the rigidity goes with the place in the element: Σ D[i, j]_pq · pattern[k, 5p + q].

    D[i, j]_pq is ∫ D[i, j] ξ^p η^q over the unit square, ξ and η from its middle.

    Args:
        a: side along x [m], > 0.
        b: side along y [m], > 0.
    """
    coefficient = _about_the_middle() * _dof_scale(a, b)
    orders, side = ((2, 0), (0, 2), (1, 1)), (-1 / a**2, -1 / b**2, -2 / (a * b))
    found = []
    for i, j in zip(RIGIDITY_ROW, RIGIDITY_COLUMN, strict=True):
        power = [[EXPONENT[:, axis] - orders[k][axis] for axis in (0, 1)] for k in (i, j)]
        factor = [_falling(EXPONENT[:, 0], orders[k][0]) * _falling(EXPONENT[:, 1], orders[k][1]) for k in (i, j)]
        weight = (factor[0][:, None] * factor[1]).double()
        # Where the factor vanishes the lowered power may be any; its place is then never used.
        place = [(power[0][axis][:, None] + power[1][axis]).clamp(0, 4) for axis in (0, 1)]
        strain = weight.new_zeros(25, N_DOF, N_DOF).scatter(0, (5 * place[0] + place[1])[None], weight[None])
        one = side[i] * side[j] * a * b * (coefficient.mT @ strain @ coefficient)
        # An off-diagonal entry of D stands at two places of the sum.
        found.append(0.5 * (one + one.mT) if i == j else one + one.mT)
    return torch.stack(found)


@lru_cache(MOST_KNOWN)
@torch.inference_mode(False)
def uneven_mass_pattern(a: float, b: float) -> Float[Tensor, "49 12 12"]:
    """The same of mass, where the areal mass goes with the place in the element: Σ m_pq · pattern[7p + q].

    Args:
        a: side along x [m], > 0.
        b: side along y [m], > 0.
    """
    coefficient = _about_the_middle() * _dof_scale(a, b)
    power = [EXPONENT[:, axis][:, None] + EXPONENT[:, axis] for axis in (0, 1)]
    products = coefficient.new_zeros(49, N_DOF, N_DOF)
    products.scatter_(0, (7 * power[0] + power[1])[None], torch.ones_like(products[:1]))
    one = a * b * (coefficient.mT @ products @ coefficient)
    return 0.5 * (one + one.mT)


def stiffness(rigidity: Float[Tensor, "*batch 3 3"], a: float, b: float) -> Float[Tensor, "*batch 12 12"]:
    """Stiffness matrices ∫ Bᵀ D B of a × b elements (seed paper, Eq. 13), one for each rigidity [N m]."""
    pattern = patterns(a, b).stiffness.to(rigidity)
    return torch.einsum("...k,kpq->...pq", rigidity[..., RIGIDITY_ROW, RIGIDITY_COLUMN], pattern)


def mass(areal_mass: Float[Tensor, "*batch"], a: float, b: float) -> Float[Tensor, "*batch 12 12"]:
    """Consistent mass matrices ∫ m Nᵀ N of a × b elements (seed paper, Eq. 14), one for each areal mass [kg/m²]."""
    return areal_mass[..., None, None] * patterns(a, b).mass.to(areal_mass)


def _falling(power: Tensor, order: int) -> Tensor:
    """Power · (power − 1) · ... with `order` factors: what differentiation puts before a monomial."""
    factor = torch.ones_like(power)
    for step in range(order):
        factor = factor * (power - step)
    return factor


def _moment(first: tuple[int, int], second: tuple[int, int]) -> Float[Tensor, "12 12"]:
    """∫ over the unit square of the product of two derivatives of the monomials, in closed form."""
    power = [[EXPONENT[:, axis] - order[axis] for axis in (0, 1)] for order in (first, second)]
    factor = [_falling(EXPONENT[:, 0], order[0]) * _falling(EXPONENT[:, 1], order[1]) for order in (first, second)]
    weight = (factor[0][:, None] * factor[1]).double()
    # Where the factor vanishes the lowered power is negative; its integral is then never used.
    integral = [(power[0][axis][:, None] + power[1][axis] + 1).clamp(min=1).double() for axis in (0, 1)]
    return weight / (integral[0] * integral[1])


@cache
def _coefficients() -> Float[Tensor, "12 12"]:
    """A⁻¹ on the unit square: from corner dofs to the coefficients of the polynomial (seed paper, Eq. 8)."""
    rows = torch.stack([monomials(CORNER), monomials(CORNER, order_y=1), -monomials(CORNER, order_x=1)], dim=1)
    # Integers with a determinant of ±1 up to small factors: rounding makes the inverse exact.
    return torch.linalg.inv(rows.reshape(N_DOF, N_DOF)).round()


@cache
def _about_the_middle() -> Float[Tensor, "12 12"]:
    """The same to those of the polynomial about the middle of the square."""
    rows = [monomials(CORNER - 0.5), monomials(CORNER - 0.5, order_y=1), -monomials(CORNER - 0.5, order_x=1)]
    return torch.linalg.inv(torch.stack(rows, dim=1).reshape(N_DOF, N_DOF))


@cache
def _dof_scale(a: float, b: float) -> Float[Tensor, "12"]:
    """From dofs in metres to dofs on the unit square: dw/dη = b dw/dy, dw/dξ = a dw/dx."""
    return torch.tensor([1.0, b, a], dtype=torch.float64).repeat(4)
