"""The rooms and the arrows between them: what each folder may import, and what its map must name."""

import ast
import functools
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

import torchplate

ROOT = Path(torchplate.__file__).parent
# Each room may use itself and those before it; search stands alone; diagnosis, identification, bench and examples may
# use all of these, planning what diagnosis may and diagnosis, the report diagnosis and identification too, the command
# line all but the examples and the studies, which stand above it and are used by none.
ROW = ("plate", "effects", "model", "measurement", "discrepancy")
MAY_USE = {room: {*ROW[: index + 1]} for index, room in enumerate(ROW)}
MAY_USE |= {"search": {"search"}, "examples": {*ROW, "search", "examples"}}
MAY_USE |= {room: {*ROW, "search", room} for room in ("bench", "diagnosis", "identification")}
MAY_USE |= {"planning": {*ROW, "search", "diagnosis", "planning"}}
MAY_USE |= {"report": {*ROW, "search", "diagnosis", "identification", "report"}}
MAY_USE |= {"cli": {*ROW, "search", "bench", "diagnosis", "identification", "planning", "report", "cli"}}
MAY_USE |= {"studies": {*MAY_USE["cli"], "studies"}}
# `torchplate --help` waits for nothing, so that the front of this room imports nothing: the studies name its modules.
NO_FRONT = {"cli"}
# No rooms but one file each, which know nothing of any.
NO_ROOM = {"nearest", "notation"}
# Alcoves of rooms: each may use itself and those before it.
ALCOVES = {
    "cli": ("schema", "config", "machine", "folder", "progress", "results", "verbs", "arguments"),
    "measurement": ("formats", "modal", "uff", "points", "records", "assessment", "virtual"),
    "model": ("receptance", "discretisation"),
    "report": ("blocks", "figures", "forms"),
}
# What only one file, or one alcove, may import, and which.
ONLY = {"yaml": "cli/config/file.py", "pydantic": "cli/schema/", "tensorboard": "cli/progress/log.py"}
VAGUE = {"utils", "util", "misc", "helpers", "helper", "common", "core", "base", "manager"}
FILES = sorted(ROOT.rglob("*.py"))
IN_ROOMS = [path for path in FILES if path.parent != ROOT]
ROOMS = sorted(path.parent for path in ROOT.rglob("__init__.py") if path.parent != ROOT)
# A crowded room has alcoves, which may use what it may.
WHOLE_ROOMS = [path for path in ROOMS if path.parent == ROOT]


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@functools.cache
def imports(path: Path) -> set[str]:
    """Every module that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name(path)} imports relatively; write the whole path."
            # `from torchplate import model` reaches a room too.
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return found


def test_every_folder_is_a_room_of_the_house():
    assert {path.name for path in WHOLE_ROOMS} == set(MAY_USE)


def broken(breaks: Callable[[Path], set], paths: Iterable[Path]) -> dict[str, set]:
    """The files that break a rule, and by what. A test for each file would be thousands, which take long to count."""
    return {name(path): by for path in paths if (by := breaks(path))}


def test_the_arrows_point_one_way():
    def against(path: Path) -> set[str]:
        used = {module.split(".")[1] for module in imports(path) if module.startswith("torchplate.")}
        return used - {*MAY_USE[path.relative_to(ROOT).parts[0]], *NO_ROOM}

    assert not broken(against, IN_ROOMS)


@pytest.mark.parametrize("room", ALCOVES)
def test_every_alcove_has_its_place(room):
    assert {path.name for path in ROOMS if path.parent == ROOT / room} == {*ALCOVES[room]}


def test_the_arrows_between_alcoves_point_one_way():
    def against(path: Path) -> set[str]:
        room, own = path.relative_to(ROOT).parts[:2]
        reached = [module.split(".") for module in imports(path) if module.startswith(f"torchplate.{room}.")]
        used = {parts[2] for parts in reached} & {*ALCOVES[room]}
        return used - {*ALCOVES[room][: ALCOVES[room].index(own) + 1]}

    assert not broken(against, (path for room in ALCOVES for path in (ROOT / room).glob("*/*.py")))


@functools.cache
def offered(room: str) -> set[str]:
    """What the front of a room offers: its `__all__`."""
    for node in ast.parse((ROOT / room / "__init__.py").read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def taken(path: Path) -> set[str]:
    """What a file imports of torchplate, each name with the module that it is taken from."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {one for one in found if one.startswith("torchplate.")}


def test_what_another_room_has_is_taken_at_its_front():
    def beyond(path: Path) -> set[tuple[str, ...]]:
        own = {path.relative_to(ROOT).parts[0], *NO_ROOM, *NO_FRONT}
        reached = {tuple(one.split(".")[1:]) for one in taken(path)}
        return {one for one in reached if one[0] not in own and (len(one) != 2 or one[1] not in offered(one[0]))}

    assert not broken(beyond, IN_ROOMS)


def test_no_file_imports_the_whole_package():
    assert not broken(lambda path: imports(path) & {"torchplate"}, IN_ROOMS)


@pytest.mark.parametrize("package", ONLY)
def test_one_file_alone_knows_each_outer_format(package):
    users = {name(path) for path in FILES if any(package in module.split(".") for module in imports(path))}
    assert users
    assert all(user.startswith(ONLY[package]) for user in users)


def test_no_name_is_vague():
    def vague(path: Path) -> set[str]:
        return {part.removesuffix(".py") for part in path.relative_to(ROOT).parts} & VAGUE

    assert not broken(vague, FILES)


@pytest.mark.parametrize("room", ROOMS, ids=name)
def test_the_docstring_of_a_room_names_each_of_its_files(room):
    docstring = ast.get_docstring(ast.parse((room / "__init__.py").read_text()))
    assert docstring
    files = {path.stem for path in room.glob("*.py")} - {"__init__"}
    if room.name == "effects":
        # One line for all: "every other file holds one effect", which the catalogue's own tests hold them to.
        files = {"effect"}
    assert not {stem for stem in files if not re.search(rf"`{stem}`|^\s+(\w+, )*{stem}\b.*:", docstring, re.MULTILINE)}


def test_every_file_says_what_it_is():
    assert not [name(path) for path in FILES if not ast.get_docstring(ast.parse(path.read_text()))]
