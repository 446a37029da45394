"""Long commands write their own row onto the verification page, and no other's."""

import importlib.util
from pathlib import Path

_SPEC = importlib.util.spec_from_file_location("torchplate_figures", Path(__file__).with_name("figures.py"))
figures = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(figures)


def test_a_command_writes_its_own_row_anew_and_leaves_the_others():
    began, ended = figures.ENDS
    page = "\n".join(["before", began, *figures.HEAD, "| b | `python x` | 3 | old |", ended, "after"])
    page = figures.with_row(figures.with_row(page, "a", "y --seed 1", "5 of 5", "abc"), "b", "x", "4", "abc")
    rows = ["| a | `python y --seed 1` | 5 of 5 | abc |", "| b | `python x` | 4 | abc |"]
    assert page.splitlines() == ["before", began, *figures.HEAD, *rows, ended, "after"]
