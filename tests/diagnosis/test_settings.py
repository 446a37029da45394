"""Every number that somebody chose for a diagnosis stands in its settings, described and read."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest

import torchplate
from torchplate.diagnosis.change.settings import ChangeSettings
from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.table.settings import TableSettings

ROOMS = [Path(torchplate.__file__).parent / room for room in ("diagnosis", "discrepancy")]
# Nobody chose these: steps of differences, rounding, memory, a print's size, and what follows from a definition.
NUMERICS = {
    *("ON_NODE", "TINY", "N_DELAY", "N_TURN", "POLISH", "N_LINE", "QUANTILE", "UNIFORM", "PARALLEL"),
    *("ENDS", "INDEPENDENT", "ON_BOUND", "STEP", "AT_ONCE", "SHORT"),
}
STAGES = [*(type(getattr(SETTINGS, stage.name)) for stage in dataclasses.fields(SETTINGS))]
STAGES += [type(SETTINGS.meshes.searching), TableSettings, ChangeSettings]


def numbers(path: Path) -> set[str]:
    """Names at the head of a module that stand for a number, or for several."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            inner = [one.operand if isinstance(one, ast.UnaryOp) else one for one in values]
            if any(isinstance(one, ast.Constant) and isinstance(one.value, int | float) for one in inner):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                found |= {one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)}
    return found


def test_no_number_that_somebody_chose_stands_at_the_head_of_a_module():
    found = set().union(*(numbers(path) for path in ROOMS[0].rglob("*.py")))
    assert found == NUMERICS


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.__name__)
def test_each_setting_is_described_with_its_unit(stage):
    assert stage.__dataclass_params__.frozen
    docstring = ast.get_docstring(ast.parse(f'class A:\n    """{stage.__doc__}"""').body[0]) or ""
    entries = dict(re.findall(r"^ +(\w+): (.*?)(?=^ +\w+: |\Z)", docstring, re.MULTILINE | re.DOTALL))
    assert {field.name for field in dataclasses.fields(stage)} == entries.keys()
    if stage.__module__.startswith("torchplate.diagnosis.settings."):
        plain = [field.name for field in dataclasses.fields(stage) if not dataclasses.is_dataclass(field.default)]
        assert [name for name in plain if not re.search(r"\[\S+\]", entries[name])] == []


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.__name__)
def test_each_setting_is_read(stage):
    text = "".join(path.read_text() for room in ROOMS for path in room.rglob("*.py"))
    assert [field.name for field in dataclasses.fields(stage) if f".{field.name}" not in text] == []
