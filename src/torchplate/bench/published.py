"""Natural frequencies that others have published of plates, which this package is held against."""

from typing import NamedTuple

AROUND = ("x0", "x1", "y0", "y1")
SUPPORTED = dict.fromkeys(AROUND, "simply_supported")
CLAMPED = dict.fromkeys(AROUND, "clamped")
CANTILEVER = {"x0": "clamped"}


class Published(NamedTuple):
    """A plate, its elastic natural frequencies, and how far they may be off.

    Attributes:
        edges: how they are held.
        values: lowest first, in the unit of its table.
        off: relative; what it is of is said at each table.
        source: who has them.
    """

    edges: dict[str, str]
    values: list[float]
    off: float
    source: str


# λ = ω a² √(ρh/D) of a square with ν = 0.3, converged Kirchhoff values to four decimals; the books have them 0.2 to
# 1.5 % higher. `off` is how far these values are themselves from converged: five units of the fifth decimal, and 1e-4
# where a clamped edge meets a free one, since the corner's singularity slows every solver.
SQUARES = {
    "free": Published(
        {}, [13.4682, 19.5961, 24.2702, 34.8009, 34.8009, 61.0932], 2e-5, "Leissa, NASA SP-160 (1969), converged"
    ),
    "cantilever": Published(
        CANTILEVER, [3.4711, 8.5071, 21.2858, 27.1990, 30.9576, 54.1893], 2.5e-4, "Leissa; Barton (1951), converged"
    ),
    "clamped": Published(
        CLAMPED, [35.9852, 73.3938, 73.3938, 108.2165, 131.5808, 132.2048], 2e-5, "Leissa (1969), converged"
    ),
}
# Hz, of 10 × 10 × 0.05 m with E 200 GPa, ν 0.3, ρ 8000. `off` is what 16 × 16 elements are, by the h² of the highest.
NAFEMS = {
    "FV12": Published(
        {},
        [1.6217, 2.3595, 2.9223, 4.1902, 4.1902, 7.3560, 7.3560, 7.6682],
        2e-3,
        "NAFEMS, Selected Benchmarks (1987), converged",
    ),
    "FV13": Published(
        SUPPORTED, [2.377, 5.942, 5.942, 9.507, 11.884, 11.884, 15.449, 15.449], 1.3e-2, "NAFEMS (1987); Navier"
    ),
    "FV16": Published(CANTILEVER, [0.4179, 1.0243, 2.5629, 3.2749, 3.7275, 6.5247], 3e-3, "NAFEMS (1987), converged"),
}
