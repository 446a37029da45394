"""The wheel and the source archive build, and what is installed from the wheel alone works."""

import importlib.metadata
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.check

CONFIG = """
mesh: {length_x: 0.4, length_y: 0.3, n_x: 6, n_y: 5}
effects:
  plate: {effect: plate, youngs_modulus: 70.0e+9, poisson_ratio: 0.33, density: 2700.0, thickness: 0.003}
  loss: {effect: hysteretic_damping, stiffness_loss_factor: 0.03}
modal_test:
  analyser: {exponential_window: null, force_window: null}
  response: [3]
  reference: [9, 20]
  refine: 1
  extrapolate: false
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with a wheel and a source archive, made by the backend from a copy of what git knows."""
    setuptools = tuple(int(part) for part in importlib.metadata.version("setuptools").split(".")[:1])
    if setuptools < (77,):
        pytest.skip(f"setuptools {setuptools[0]} is here, and 77 or newer is needed to build without a registry")
    folder = tmp_path_factory.mktemp("built")
    copy = folder / "project"
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    if listed.returncode:
        pytest.skip("no git checkout, so nobody knows which files belong to the project")
    for name in filter(None, listed.stdout.split("\0")):
        source = ROOT / name
        if source.is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            (copy / name).write_bytes(source.read_bytes())
    build(copy, folder, "wheel", "sdist")
    return folder


def build(project: Path, folder: Path, *kinds: str) -> None:
    """What a build front end asks of the backend."""
    asked = "; ".join(f"backend.build_{kind}({str(folder)!r})" for kind in kinds)
    code = f"import setuptools.build_meta as backend; {asked}"
    subprocess.run([sys.executable, "-c", code], cwd=project, check=True, capture_output=True)


@pytest.fixture(scope="module")
def installed(built: Path) -> Path:
    """Python of an environment that holds the wheel; torch and the others are lent by this one."""
    home = built / "environment"
    venv.create(home, with_pip=False, symlinks=True)
    python = home / ("Scripts" if os.name == "nt" else "bin") / "python"
    where = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    )
    site = Path(where.stdout.strip())
    (wheel,) = built.glob("*.whl")
    options = ["--no-deps", "--no-index", "--no-compile", "--ignore-installed", "--quiet"]
    run(Path(sys.executable), "-m", "pip", "--python", str(python), "install", *options, str(wheel), folder=built)
    # A line of a .pth file adds the folder but not what its own .pth files name: the editable install stays out.
    (site / "lent.pth").write_text(sysconfig.get_path("purelib"))
    return python


def run(python: Path, *words: str, folder: Path) -> str:
    """What a command prints in an environment that knows nothing of this checkout."""
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run([str(python), *words], cwd=folder, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_the_package_and_nothing_else(built):
    (wheel,) = built.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "torchplate/py.typed" in names
    sources = {path.relative_to(ROOT / "src").as_posix() for path in (ROOT / "src").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == sources
    assert {name.split("/")[0].split("-")[0] for name in names} == {"torchplate", "torchplate_fem"}


def test_the_source_archive_builds_again(built, tmp_path):
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        opened.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.iterdir()
    assert {"pyproject.toml", "README.md", "src"} <= {path.name for path in unpacked.iterdir()}
    build(unpacked, tmp_path, "wheel")
    (again,), (wheel,) = tmp_path.glob("*.whl"), built.glob("*.whl")
    assert {*zipfile.ZipFile(again).namelist()} == {*zipfile.ZipFile(wheel).namelist()}


def test_the_installed_package_is_the_one_of_the_wheel(installed, tmp_path):
    where = run(installed, "-c", "import torchplate; print(torchplate.__file__)", folder=tmp_path)
    assert Path(where.strip()).is_relative_to(installed.parents[1])


def test_an_example_runs_from_the_wheel(installed, tmp_path):
    (tmp_path / "plate.yaml").write_text(CONFIG)
    command = installed.parent / "torchplate"
    assert command.exists()
    run(installed, str(command), "simulate", "plate.yaml", "--out", "test.uff", folder=tmp_path)
    run(
        installed,
        str(command),
        "run",
        "plate.yaml",
        "--set",
        "measurement={file: test.uff, band: [30, 200]}",
        "--out",
        "out",
        folder=tmp_path,
    )
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["schema"] == "torchplate.result/1"
    # The virtual test is of the same mesh: noise, windows and leakage alone are between them.
    assert result["gap"] < 0.3
