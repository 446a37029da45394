"""The paper's Table 5 from its Table 4: a table that a program printed of that very mesh."""

from pathlib import Path

import pytest

from torchplate.cli.verbs.diagnose import diagnose

pytestmark = pytest.mark.check

CONFIG = Path(__file__).parents[2] / "configs" / "real" / "paper_table5.yaml"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Its diagnosis."""
    return diagnose(CONFIG, tmp_path_factory.mktemp("table5"), report=False)


def test_the_table_is_found_to_come_from_the_given_mesh(found):
    assert any("the mesh as given has the probability 1." in sentence for sentence in found.remarks)
    assert not [one for one in found.effects if one.name == "mesh_discretisation"]
    assert found.model.assembly.correction is None


def test_a_pair_leaves_less_than_a_single_effect_and_something_is_still_missing(found):
    assert found.verdict == "partly_explained"
    assert len(found.effects) == 2
    assert found.gap.final < found.steps[1].gap < found.gap.baseline
    assert found.missing
