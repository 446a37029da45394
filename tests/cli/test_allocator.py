"""Memory that is freed is used again, not asked of the system anew."""

import subprocess
import sys

import pytest

# A tensor of 40 MiB is made and freed; tells how often the system had to hand out a page once some had been before,
# untold and told.
WORK = """
import resource, torch
from torchplate.cli.machine.allocator import keep_freed_memory
def work(turns):
    for _ in range(turns):
        torch.ones(5 * 2**20, dtype=torch.float64)
def pages():
    work(40)
    began = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    work(20)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - began
print(pages())
keep_freed_memory()
print(pages())
"""
PAGES = 5 * 2**20 * 8 // 4096


@pytest.mark.check
@pytest.mark.skipif(sys.platform != "linux", reason="only the GNU C library is told")
def test_the_system_is_not_asked_for_the_pages_of_each_tensor():
    told = subprocess.run([sys.executable, "-c", WORK], capture_output=True, check=True).stdout
    untold, kept = map(int, told.split())
    assert kept < PAGES
    # Untold, it is asked for all of them each time.
    assert untold > 10 * PAGES
