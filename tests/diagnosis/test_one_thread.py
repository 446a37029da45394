"""What takes one model at a time has one thread, however many the process has."""

import pytest
import torch

import torchplate as tp
from torchplate.diagnosis import one_thread
from torchplate.measurement import NaturalFrequencies

TABLE = NaturalFrequencies.from_mapping({7: 30.0, 8: 45.0, 9: 70.0})


class StoppedError(Exception):
    pass


def stop(_: str) -> None:
    raise StoppedError(f"{torch.get_num_threads()} at work")


@pytest.fixture
def of_two():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_there_is_one_meanwhile_and_then_as_many_as_before(of_two):
    with pytest.raises(StoppedError, match="1 at work"), one_thread():
        stop("")
    assert torch.get_num_threads() == 2


def test_a_diagnosis_takes_one(of_two, lab):
    with pytest.raises(StoppedError, match="1 at work"):
        tp.diagnose(lab.plate(), natural_frequencies=TABLE, say=stop)
    assert torch.get_num_threads() == 2


def test_what_changed_takes_one(of_two, lab):
    test = tp.PlateTest(lab.plate(), natural_frequencies=TABLE)
    with pytest.raises(StoppedError, match="1 at work"):
        tp.what_changed(test, test, say=stop)
    assert torch.get_num_threads() == 2
