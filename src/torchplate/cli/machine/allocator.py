"""Memory that is freed stays with the process, to be used again.

A search makes and frees tensors of some megabytes thousands of times. The GNU C library hands memory at the end of its
heap back to the system as soon as it is free, and the system clears each page of it when it is asked for again: a tenth
of a diagnosis. Elsewhere (macOS, musl) nothing is changed. Source: mallopt(3).
"""

import ctypes

# Names of mallopt: up to which size blocks are taken from the heap, and how much free memory its end may hold.
MMAP_THRESHOLD, TRIM_THRESHOLD = -3, -1
# 64 and 256 MiB: a population's FRFs, and a few of them.
LARGEST, KEPT = 2**26, 2**28


def keep_freed_memory() -> None:
    """For the rest of the process."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(TRIM_THRESHOLD, KEPT)
        mallopt(MMAP_THRESHOLD, LARGEST)
