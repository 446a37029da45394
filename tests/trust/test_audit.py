"""`make audit` says what was audited: all, what the database knows, or nothing."""

import shutil
import subprocess
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UNKNOWN = "torch  Dependency not found on PyPI and could not be audited: torch"
FOUND = "Found 2 known vulnerabilities in 1 package\nName Version ID Fix Versions"


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not there")
@pytest.mark.parametrize(
    ("said", "ended", "status", "sentence"),
    [
        ("No known vulnerabilities found", 0, 0, ""),
        (f"No known vulnerabilities found\n{UNKNOWN}\n{UNKNOWN}", 0, 2, "The database does not know 2 of the "),
        (f"{FOUND}\n{UNKNOWN}", 1, 2, "Expected pinned packages without a known vulnerability, got those above."),
        ("ConnectionError: Name or service not known", 1, 2, "nothing was audited"),
    ],
    ids=["clean", "unknown", "vulnerable", "silent"],
)
def test_an_audit_says_what_was_audited(tmp_path, said, ended, status, sentence):
    scripts = tmp_path / "bin"
    scripts.mkdir()
    for name, text in (("pip", ""), ("pip-audit", f"cat <<'END'\n{said}\nEND\nexit {ended}\n")):
        (scripts / name).write_text(f"#!/bin/sh\n{text}")
        (scripts / name).chmod(0o755)
    for name in (".torch", ".check"):
        (tmp_path / name).touch()
        time.sleep(0.01)
    command = ["make", "-C", str(ROOT), "audit", f"VENV={tmp_path}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    told = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert len(told) == bool(sentence)
    assert all(sentence in line for line in told)
