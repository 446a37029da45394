"""One member of the model in sparse matrices: modes, residuals and FRFs on meshes too fine for dense ones.

The eigensolver is ARPACK by shift-invert, the direct solves are SuperLU, both through scipy.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.linalg
import torch
from jaxtyping import Complex, Float
from threadpoolctl import threadpool_limits
from torch import Tensor

from torchplate.model.discretisation.direct_solves import Solve, cut, factor, solver, with_low_rank
from torchplate.model.plate_model import PlateModel
from torchplate.model.receptance.modes import Modes
from torchplate.plate import STIFFEST, AddedMass

# Beyond so many dofs the full model is never solved densely: modes by sparse shift-invert, checks by sparse solves.
DENSE = 1000
# Shift below zero [rad²/s²]: a free plate's K is singular, K + shift M is not. About 5 Hz.
SHIFT = 1e3
# Dofs for each mode that is wanted, up to which all modes by LAPACK take about as long as these alone by shift-invert.
WHOLE = 8
# Modes asked for beyond those expected: the count of a single plate scatters about its mean.
SPARE = 8
# Steps of inverse iteration from modes of a coarser mesh.
N_STEP = 2
# Steps of inverse iteration from a space that nearly holds the modes, at most; relative change of the eigenvalues at
# which they are at rest: the highest modes that are wanted come last, those three times lower long before; columns
# drawn at random beside that space, for modes that are none of its kind; and modes beyond those that are wanted.
MOST_STEPS, AT_REST, N_DRAWN, BEYOND = 8, 1e-6, 8, 2
# The same for these: a tenth of how far twins are apart at most.
APART = 1e-3
# Part of the strongest of these columns below which one is made of rounding.
ROUNDING = 1e-12


class SparseModel:
    """K and M of one member, and what is solved with them, in float64 on the CPU.

    Args:
        model: the full model.
        theta: its searched parameters in SI units.
    """

    def __init__(self, model: PlateModel, theta: Float[Tensor, " n_parameter"]) -> None:
        self.model, self.theta = model, theta
        self.plan = model.plan(theta)
        matrices = model.assembly.sparse(self.plan.section, self.plan.geometry, self.plan.terms)
        self.stiffness, self.mass, self.viscous, self.hysteretic = matrices
        # Masses on springs, one by one.
        self.hung = [term for term in self.plan.terms if term.sprung is not None]
        self._factor: Any = None
        # What a finer mesh would add is of low rank and dense: it stays beside the sparse stiffness.
        self.correction: tuple[np.ndarray, np.ndarray] | None = None
        # The same of the stiffness that is lost in the elements.
        self._lost: np.ndarray | None = None
        if (more := model.assembly.correction) is not None:
            section = self.plan.section
            scale = more.scale(section.rigidity, self.plan.geometry)
            self.correction = more.rows.cpu().numpy(), (scale * more.stiffness.to(scale)).cpu().numpy()
            if self.hysteretic is not None:
                scale, middle = more.lost(section.lossy_rigidity, self.plan.geometry)
                self._lost = (scale * middle.to(scale)).cpu().numpy()
        self._terms = self._local_terms()
        self._spread = [_Spread(model, one) for one in self.plan.added]

    def _local_terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Of the local terms: rows r, as the sparse matrices have them; r S; and of each part of Z, which are in it.

        The parts are stiffness, mass and dashpots, and a part for each mass on a spring.

        A corrected row is r + r S R. None where nothing is corrected.
        """
        correction, terms = self.model.assembly.correction, self.plan.terms
        if correction is None or not terms:
            return None
        row = torch.cat([term.vector[..., self.model.assembly.free] for term in terms]).double().cpu()
        none = [torch.zeros(len(term.vector)) for term in terms]
        parts = [
            torch.cat([zero if value is None else value.cpu() for zero, value in zip(none, values, strict=True)])
            for values in zip(*((term.stiffness, term.mass, term.viscous) for term in terms), strict=True)
        ]
        counts = [len(term.vector) for term in terms]
        of_hung = [
            torch.arange(len(row)) == sum(counts[:index]) + one
            for index, term in enumerate(terms)
            if term.sprung is not None
            for one in range(counts[index])
        ]
        shape = row @ correction.shape.double().cpu()
        return row.numpy(), shape.numpy(), torch.stack([*parts, *(own.to(row) for own in of_hung)]).double().numpy()

    def lacking(self, columns: np.ndarray) -> list[np.ndarray | float]:
        """What each of the sparse parts of Z lacks, times columns; see `impedance_parts`.

        That is a correction, and masses that are spread over the plate.
        """
        spread: np.ndarray | float = sum((one.times(columns) for one in self._spread), 0.0)
        none: list[np.ndarray | float] = [spread, *[0.0] * (1 + self._n_hung)]
        if self.correction is None:
            return [0.0, *none, *[0.0] * (self.hysteretic is not None)]
        rows, middle = self.correction
        seen = rows @ columns
        found: list[np.ndarray | float] = [rows.T @ (middle @ seen), *none]
        if self._lost is not None:
            found.append(rows.T @ (self._lost @ seen))
        if self._terms is None:
            return found
        row, shape, parts = self._terms
        more = shape @ seen
        for index, part in enumerate(parts):
            # (r + rSR)ᵀ c (r + rSR) − rᵀ c r
            pushed = part[:, None] * (row @ columns + more)
            found[index] = found[index] + rows.T @ (shape.T @ pushed) + row.T @ (part[:, None] * more)
        return found

    def _low_rank(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """The same as Uᵀ B U, for the parts of Z times these; None where nothing is lacking."""
        if self.correction is None:
            return None
        rows, middle = self.correction
        corner = weight[0] * middle
        if self._lost is not None:
            corner = corner + weight[-1] * self._lost
        if self._terms is None:
            return rows, corner
        row, shape, parts = self._terms
        pushed = (weight[: len(parts)] @ parts)[:, None] * shape
        corner = corner + shape.T @ pushed
        empty = np.zeros((len(row), len(row)))
        return np.concatenate([rows, row]), np.block([[corner, pushed.T], [pushed, empty]])

    @property
    def _n_hung(self) -> int:
        return sum(len(term.vector) for term in self.hung)

    def _undamped(self) -> tuple[Any, Any]:
        """K and M with the motion of masses on springs as further coordinates; see `System.undamped`.

        Without the correction of their rows, as those of springs to the ground are taken here.
        """
        n = self._n_hung
        carrier = torch.cat([term.vector[..., self.model.assembly.free] for term in self.hung]).double().cpu().numpy()
        mass, spring, _ = (
            torch.cat(parts).double().cpu().numpy()
            for parts in zip(*(term.sprung for term in self.hung if term.sprung is not None), strict=True)
        )
        link = scipy.sparse.hstack([scipy.sparse.csr_array(carrier), -scipy.sparse.eye_array(n)], format="csr")
        empty = scipy.sparse.csr_array((n, n))
        stiffness, inertia = (scipy.sparse.block_diag([part, empty]).tocsr() for part in (self.stiffness, self.mass))
        stiffness = stiffness + link.T @ scipy.sparse.diags_array(spring) @ link
        inertia = inertia + link.T @ scipy.sparse.diags_array(spring / STIFFEST**2) @ link
        return stiffness, inertia + scipy.sparse.diags_array(np.pad(mass, (len(self.model.assembly.free), 0)))

    def modes(
        self,
        n_mode: int,
        frequency: float = 0.0,
        dense: bool = False,
        bare: bool = False,
        near: Float[Tensor, "n k"] | None = None,
    ) -> Modes:
        """The lowest modes: at least `n_mode`, all up to `frequency` [Hz], and one beyond.

        Args:
            n_mode: how many at least.
            frequency: up to where.
            dense: solve for all modes by LAPACK; faster on small meshes.
            bare: without masses on springs, each of which adds a mode; shapes are those of the plate either way.
            near: columns that the modes are nearly made of, as those of another member; not where all are solved for.
        """
        stiffness, correction = self.stiffness, self.correction
        mass: Any = self.mass
        solve: Solve = self.solve
        size = stiffness.shape[0]
        if self.hung and not bare:
            stiffness, mass = self._undamped()
            if correction is not None:
                correction = np.pad(correction[0], ((0, 0), (0, self._n_hung))), correction[1]
            if not dense:
                solve = self._shifted(stiffness, mass, correction)
        n = stiffness.shape[0]
        if dense:
            whole = stiffness.toarray()
            if correction is not None:
                rows, middle = correction
                whole = whole + rows.T @ middle @ rows
            value, shape = scipy.linalg.eigh(whole, self._times(mass, np.eye(n)))
        else:
            if near is not None and (known := self._modes_from(near, solve, mass, n_mode, frequency)) is not None:
                return known
            if self._spread:
                mass = scipy.sparse.linalg.LinearOperator(
                    (n, n), matvec=functools.partial(self._times, mass), dtype=np.float64
                )
            count = self._count(n_mode, frequency)
            while True:
                count = min(count, n - 2)
                inverse = scipy.sparse.linalg.LinearOperator((n, n), matvec=solve, dtype=np.float64)
                start = np.random.default_rng(0).standard_normal(n)
                value, shape = scipy.sparse.linalg.eigsh(
                    stiffness, count, mass, sigma=-SHIFT, OPinv=inverse, v0=start, tol=1e-10,
                    ncv=min(n, 3 * count // 2),
                )  # fmt: skip
                order = value.argsort()
                value, shape = value[order], shape[:, order]
                if value[-1] > (2 * np.pi * frequency) ** 2 or count == n - 2:
                    break
                # Modes of a plate are evenly spaced in frequency: the wanted number, and some more.
                reached = float(value[-1].clip(min=1.0) ** 0.5 / (2 * np.pi))
                count = max(count + 10, int(1.15 * count * frequency / reached))
        like = self.model.known
        return Modes(torch.from_numpy(value).to(like), torch.from_numpy(np.ascontiguousarray(shape[:size])).to(like))

    def is_sooner_dense(self, n_mode: int, frequency: float = 0.0) -> bool:
        """Whether solving for all modes takes no longer than for some of them; never on large meshes.

        Args:
            n_mode: how many are wanted at least.
            frequency: up to where [Hz].
        """
        size = self.stiffness.shape[0]
        return size <= min(DENSE, WHOLE * self._count(n_mode, frequency))

    def _count(self, n_mode: int, frequency: float) -> int:
        """How many modes are asked for first."""
        return max(n_mode + 2, 20, self._most_modes(frequency) + SPARE)

    def _modes_from(
        self,
        near: Float[Tensor, "n k"],
        solve: Solve,
        mass: Any,
        n_mode: int,
        frequency: float,
    ) -> Modes | None:
        """The lowest modes by inverse iteration of a space of columns; None where they do not come to rest.

        Of all columns at once: a solve for many costs half of one for each (Bathe and Wilson, Solution methods for
        eigenvalue problems in structural mechanics, Int. J. Num. Meth. Eng. 6, 1973, 213).
        """
        own, n = len(near), mass.shape[0]
        found = np.zeros((n, near.shape[1] + n - own + N_DRAWN))
        found[:own, : near.shape[1]] = near.double().cpu().numpy()
        # Masses on springs may move alone.
        found[own:, near.shape[1] : found.shape[1] - N_DRAWN] = np.eye(n - own)
        found[:, found.shape[1] - N_DRAWN :] = np.random.default_rng(0).standard_normal((n, N_DRAWN))
        before, last = np.zeros(0), np.inf
        for left in reversed(range(MOST_STEPS)):
            forces = self._times(mass, found)
            moved = solve(forces)
            length = np.linalg.norm(moved, axis=0)
            moved, forces = moved / length, forces / length
            inertia = moved.T @ self._times(mass, moved)
            strength, turn = scipy.linalg.eigh(0.5 * (inertia + inertia.T))
            kept = strength > ROUNDING * strength[-1]
            turn = turn[:, kept] / np.sqrt(strength[kept])
            moved, forces = moved @ turn, forces @ turn
            # K W = M V − s M W.
            stiffness = moved.T @ forces - SHIFT * np.eye(moved.shape[1])
            value, turn = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T))
            found = moved @ turn
            # With some beyond, of which one may be the twin of the last.
            count = BEYOND + max(n_mode, int((value <= (2 * np.pi * frequency) ** 2).sum()))
            if count < min(len(value), len(before)):
                moved_by = np.abs(value[:count] - before[:count]) / (value[:count] + 2 * SHIFT)
                # Of those beyond it is enough to see which are twins.
                moved_by[count - BEYOND :] *= AT_REST / APART
                change = float(moved_by.max(initial=0.0))
                if change <= AT_REST:
                    like = self.model.known
                    shape = np.ascontiguousarray(found[:own, :count])
                    return Modes(torch.from_numpy(value[:count]).to(like), torch.from_numpy(shape).to(like))
                # At this rate it would not be at rest in time.
                if np.isfinite(last) and change * (change / last) ** left > AT_REST:
                    return None
                last = change
            before = value
        return None

    def modes_near(self, shape: Float[Tensor, "n n_mode"]) -> Modes:
        """As many modes from approximate ones, by steps of inverse iteration: those of a coarser mesh, say.

        On one thread: more sum in another order, and of so few columns are no faster.

        Masses on springs are left out. With V the approximate ones and W = (K + s M)⁻¹ M V, eigenvalues are those of
        Wᵀ K W beside Wᵀ M W, off by the square of what W misses; what lies far above is missed less with each step.
        Source: Xu and Zhou, A two-grid discretization scheme for eigenvalue problems, Mathematics of Computation 70
        (2001) 17.
        """
        found = shape.double().cpu().numpy()
        with threadpool_limits(limits=1, user_api="blas"):
            for _ in range(N_STEP):
                forces = self._times_mass(found)
                moved = self.solve(forces)
                size = np.linalg.norm(moved, axis=0)
                moved, forces = moved / size, forces / size
                inertia = moved.T @ self._times_mass(moved)
                # K W = M V − s M W.
                stiffness = moved.T @ forces - SHIFT * inertia
                value, turn = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), inertia)
                found = moved @ turn
        like = self.model.known
        return Modes(torch.from_numpy(value).to(like), torch.from_numpy(found).to(like))

    def _most_modes(self, frequency: float) -> int:
        """About how many modes a plate with these sides has up to a frequency if its edges are free, the most it can.

        N = (A k² + 1.7125 P k) / 4π, k the bending wave number, A the area, P the perimeter (Bogomolny and Hugues,
        Phys. Rev. E 57, 1998, 5404: ν = 0.3).
        """
        section, geometry = self.plan.section, self.plan.geometry
        rigidity = (section.rigidity[..., 0, 0] * section.rigidity[..., 1, 1]).sqrt().mean()
        x, y = float(geometry.length_x), float(geometry.length_y)
        squared = 2 * np.pi * frequency * float(section.areal_mass.mean() / rigidity) ** 0.5
        return int((x * y * squared + 1.7125 * 2 * (x + y) * squared**0.5) / (4 * np.pi))

    def residual(self, shape: Float[Tensor, "n n_mode"], forces: Float[Tensor, "n_row n"]) -> Float[Tensor, "n n_row"]:
        """What static forces move beyond the given modes: (K + shift M)⁻¹ f, made M-orthogonal to the modes."""
        modes = shape.double().cpu().numpy()
        moved = self.solve(forces.double().cpu().numpy().T.copy())
        moved = moved - modes @ (modes.T @ self._times_mass(moved))
        return torch.from_numpy(moved).to(shape)

    def times_mass(self, columns: Float[Tensor, "n n_column"]) -> Float[Tensor, "n n_column"]:
        """M times columns."""
        return torch.from_numpy(self._times_mass(columns.double().cpu().numpy())).to(columns)

    def _times_mass(self, columns: np.ndarray) -> np.ndarray:
        return self._times(self.mass, columns)

    def _times(self, mass: Any, columns: np.ndarray) -> np.ndarray:
        """A mass matrix of the plate, masses on springs beside it or not, and what is spread over it, times columns."""
        found: np.ndarray = mass @ columns
        for one in self._spread:
            found[: one.rows.shape[1]] += one.times(columns[: one.rows.shape[1]])
        return found

    def frf(self, frequency: Float[Tensor, " n_frequency"]) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """The model's FRFs by one sparse solve of the dynamic stiffness at each line."""
        return self.observed(frequency, self._receptance)

    def observed(
        self, frequency: Float[Tensor, " n_frequency"], solve: Callable[[Tensor, Tensor, Tensor], Tensor]
    ) -> Complex[Tensor, "n_frequency n_response n_reference"]:
        """The model's FRFs from any way to solve for receptances; see `PlateModel.observed`."""
        return self.model.observed(self.theta, self.plan, frequency, solve)

    def impedance_parts(
        self, laplace: Complex[Tensor, " n_frequency"]
    ) -> tuple[list[scipy.sparse.csr_array], np.ndarray]:
        """Matrices, and what each is times at every s [n_part, n_frequency], so that their sum is Z(s) [N/m].

        Without the correction; see `lacking`.
        """
        kappa, mu = self.model.assembly.proportional(self.plan.damping).at(laplace)
        parts, weight = [self.stiffness, self.mass, self.viscous], [kappa, mu, laplace]
        for term in self.hung:
            assert term.sprung is not None
            rows = term.vector[..., self.model.assembly.free].double().cpu().numpy()
            parts += [scipy.sparse.csr_array(row[:, None]) @ scipy.sparse.csr_array(row[None]) for row in rows]
            weight += list(term.sprung.force(laplace))
        if self.hysteretic is not None:
            parts, weight = [*parts, self.hysteretic], [*weight, torch.full_like(laplace, 1j)]
        return parts, torch.stack(torch.broadcast_tensors(*weight)).numpy()

    def solve(self, right: np.ndarray) -> np.ndarray:
        """(K + shift M)⁻¹ times columns; the factors are kept."""
        if self._factor is None:
            self._factor = self._shifted(self.stiffness, self.mass, self.correction)
        found: np.ndarray = self._factor(right)
        return found

    def _shifted(
        self,
        stiffness: scipy.sparse.csr_array,
        mass: scipy.sparse.csr_array,
        correction: tuple[np.ndarray, np.ndarray] | None,
    ) -> Solve:
        """Solves with K + shift M, which is positive definite: no pivot is needed."""
        whole = self._beside(stiffness + SHIFT * mass, SHIFT)
        return with_low_rank(cut(factor(whole.tocsc()).solve, stiffness.shape[0], whole.shape[0]), correction)

    def _beside(self, matrix: scipy.sparse.csr_array, weight: float | complex) -> scipy.sparse.csr_array:
        """A matrix of the plate, bordered by what is spread over it.

        Z + w c Rᵀ C R is what is left of [[Z, Rᵀ], [R, −(w c C)⁻¹]] where the lower unknowns are eliminated: so the
        sparse part stays as it is.
        """
        some = [one for one in self._spread if weight * one.coefficient]
        if not some:
            return matrix
        rows: Any = scipy.sparse.vstack([one.rows for one in some])
        rows = scipy.sparse.hstack([rows, scipy.sparse.csr_array((rows.shape[0], matrix.shape[0] - rows.shape[1]))])
        own: Any = scipy.sparse.block_diag([-one.inverse / (weight * one.coefficient) for one in some])
        return scipy.sparse.block_array([[matrix, rows.T], [rows, own]], format="csr")

    def _receptance(self, laplace: Tensor, response: Tensor, reference: Tensor) -> Tensor:
        # By reciprocity it is enough to solve for the fewer side.
        turned = len(response) < len(reference)
        few, many = (
            rows.double().cpu().numpy() for rows in ((response, reference) if turned else (reference, response))
        )
        parts, weight = self.impedance_parts(laplace)
        lines = []
        for line in weight.T:
            impedance = sum(w * part for part, w in zip(parts, line, strict=True))
            whole = self._beside(impedance, line[1])
            solve = with_low_rank(cut(solver(whole.tocsc()), impedance.shape[0], whole.shape[0]), self._low_rank(line))
            found = many @ solve(few.T.astype(complex))
            lines.append(found.T if turned else found)
        return torch.from_numpy(np.stack(lines)).to(laplace)


class _Spread:
    """A mass that is spread over the plate, of one member."""

    def __init__(self, model: PlateModel, added: AddedMass) -> None:
        self.rows = scipy.sparse.csr_array(added.rows[..., model.assembly.free.cpu()].double().cpu().numpy())
        self.coupling = added.coupling.double().cpu().numpy()
        self.coefficient = float(added.coefficient)

    @functools.cached_property
    def inverse(self) -> np.ndarray:
        """C⁻¹."""
        found: np.ndarray = np.linalg.inv(self.coupling)
        return found

    def times(self, columns: np.ndarray) -> np.ndarray:
        """C Rᵀ C R times columns."""
        found: np.ndarray = self.coefficient * (self.rows.T @ (self.coupling @ (self.rows @ columns)))
        return found
