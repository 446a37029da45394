"""Memory that was freed goes back to the system."""

import subprocess
import sys

import pytest

# Every second of many tensors of 100 KiB is freed, so that no hole is larger; tells what part of their memory was given
# back [-] unasked, where little is made next, and where much is. The threshold is that from which blocks have pages of
# their own, kept from moving.
WORK = """
import ctypes, torch
from torchplate.diagnosis.freed_memory import hand_back
ctypes.CDLL(None).mallopt(-3, 2**26)
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
many = [torch.ones(100 * 2**7, dtype=torch.float64) for _ in range(2000)]
full = resident()
freed = sum(one.nbytes for one in many[::2])
del many[::2]
for n_next in (0, 2**18, 2**20):
    if n_next:
        hand_back(n_next)
    print((full - resident()) / freed)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only the GNU C library is asked")
@pytest.mark.check
def test_pages_between_those_in_use_go_back():
    told = subprocess.run([sys.executable, "-c", WORK], capture_output=True, check=True).stdout
    unasked, of_little, of_much = map(float, told.split())
    # But for the pages that a hole shares with its neighbours: one of 25.
    assert of_much > 0.9
    # Unasked, none do; nor where little is made next.
    assert unasked < 0.1
    assert of_little < 0.1
