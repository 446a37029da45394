"""The house keeps to its seconds, and one that takes longer is told by the exit status."""

import importlib.util
from pathlib import Path

import pytest

_SPEC = importlib.util.spec_from_file_location("torchplate_house", Path(__file__).with_name("house.py"))
house = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(house)


@pytest.mark.check
def test_seconds_of_the_processor_are_counted_and_those_of_waiting_are_not():
    assert house.seconds(["-c", "import time; time.sleep(1.5)"]) < 1.0
    busy = "import time\nwhile time.process_time() < 1.2: pass"
    assert 1.1 < house.seconds(["-c", busy]) < 3.0


@pytest.mark.parametrize(("allowed", "status"), [(20.0, 0), (0.0, 1), (None, 0)])
def test_what_takes_longer_than_it_may_ends_with_1(monkeypatch, capsys, allowed, status):
    monkeypatch.setattr(house, "HOUSE", {"nothing": (["-c", "pass"], allowed)})
    assert house.main(["--times", "1"]) == status
    assert capsys.readouterr().out.startswith("`nothing` 0.")


FRF = """
import sys, torch, torchplate as tp
from torchplate.plate import Mesh
from torchplate.effects import Plate, SupportSpring
known = {"plate.youngs_modulus": 7e10, "plate.poisson_ratio": 0.3, "plate.density": 2700.0, "plate.thickness": 3e-3}
known |= {"wires.stiffness": 900.0, "wires.viscous_damping": 1.0}
effects = {"plate": Plate(), "wires": SupportSpring(nodes=(2, 5))}
model = tp.PlateModel(Mesh(0.4, 0.3, 3, 2), effects, known, {}, [3], [7])
model.frf(torch.zeros(0, dtype=torch.float64), torch.linspace(5.0, 90.0, 9, dtype=torch.float64))
assert "torch" in sys.modules and "sympy" not in sys.modules
"""


@pytest.mark.check
def test_an_frf_is_had_without_sympy():
    # A third of a second, which `torch.broadcast_shapes` takes when it is first called.
    assert house.seconds(["-c", FRF]) > 0


@pytest.mark.check
def test_the_package_is_imported_and_its_help_is_said_in_the_seconds_allowed():
    assert house.main(["--times", "3"]) == 0


def test_what_takes_hardly_any_time_takes_some_and_what_fails_is_said():
    assert all(0 < house.seconds(["-S", "-c", "pass"]) < 1 for _ in range(20))
    with pytest.raises(RuntimeError, match="to end with 0, got 3"):
        house.seconds(["-c", "raise SystemExit(3)"])
