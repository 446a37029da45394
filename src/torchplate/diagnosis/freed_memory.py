"""Memory that was freed goes back to the system before much more is taken.

Columns of nuisances and Jacobians of many FRFs are freed between smaller things that are not, and what is made next may
not fit into the holes: the process would hold half as much again as is in use. The GNU C library hands whole pages in
the holes back when it is asked; elsewhere (macOS, musl) nothing is done. Source: malloc_trim(3).
"""

import ctypes
import sys

# Numbers of a column from which on it is done: half a megabyte, of which there are a hundred. Below, what the system
# clears anew is a twentieth of the time of a diagnosis, and the memory is none to speak of.
MUCH = 2**16


def hand_back(n_number: int = MUCH) -> None:
    """Now: some milliseconds, and the system clears those pages again that are taken anew.

    Args:
        n_number: of what is to be made, in one column; below `MUCH` nothing is done.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if n_number >= MUCH and sys.platform == "linux" else None
    if trim is not None:
        trim(ctypes.c_size_t(0))
