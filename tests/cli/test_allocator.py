"""Memory that is freed is used again, not asked of the system anew."""

import subprocess
import sys

import pytest

# A tensor of 40 MiB is made and freed; tells how often the system had to hand out a page once some had been before.
WORK = """
import resource, torch
{before}
def work(turns):
    for _ in range(turns):
        torch.ones(5 * 2**20, dtype=torch.float64)
work(40)
began = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
work(20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - began)
"""
KEEP = "from torchplate.cli.machine.allocator import keep_freed_memory; keep_freed_memory()"
PAGES = 5 * 2**20 * 8 // 4096


def pages(before: str) -> int:
    command = [sys.executable, "-c", WORK.format(before=before)]
    return int(subprocess.run(command, capture_output=True, check=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="only the GNU C library is told")
def test_the_system_is_not_asked_for_the_pages_of_each_tensor():
    assert pages(KEEP) < PAGES
    # Untold, it is asked for all of them each time.
    assert pages("") > 10 * PAGES
