"""Memory that was freed goes back to the system before much more is taken.

Columns of nuisances and Jacobians of many FRFs are freed between smaller things that are not, and what is made next may
not fit into the holes: the process would hold half as much again as is in use. The GNU C library hands whole pages in
the holes back when it is asked; elsewhere (macOS, musl) nothing is done. Source: malloc_trim(3).
"""

import ctypes
import sys

# Bytes of a column from which on it is worth the milliseconds, and that the system clears pages that are taken anew:
# some seventy columns of nuisances, fifty of a Jacobian and as many in passing are then a hundred megabytes.
LONG = 2**19


def hand_back(n_byte: int) -> None:
    """Now, where it is worth it.

    Args:
        n_byte: of a column of what is made next, as long as all FRFs that are looked at.
    """
    if n_byte < LONG:
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(ctypes.c_size_t(0))
