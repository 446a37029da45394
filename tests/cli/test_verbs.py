"""The words of the command line: their help, their examples, and what asking for them costs."""

import os
import shlex
import subprocess
import sys

import pytest

import torchplate
from torchplate.cli.arguments import VERBS
from torchplate.cli.main import main, parser


def modules_after(code: str) -> set[str]:
    """What a fresh Python has imported once it has run this."""
    told = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print('\\n' + ' '.join(sys.modules))"],
        capture_output=True,
        text=True,
        check=True,
    )
    return set(told.stdout.splitlines()[-1].split())


@pytest.mark.parametrize("name", VERBS)
def test_the_help_of_each_verb_ends_with_examples(name, capsys):
    with pytest.raises(SystemExit) as exit:
        main([name, "--help"])
    assert exit.value.code == 0
    shown = capsys.readouterr().out
    assert any(line.split()[:2] == ["torchplate", name] for line in VERBS[name].examples)
    assert shown.rstrip().endswith(VERBS[name].examples[-1])


@pytest.mark.parametrize(("name", "line"), [(name, line) for name, verb in VERBS.items() for line in verb.examples])
def test_each_example_is_a_command_that_can_be_given(name, line):
    words = shlex.split(line, comments=True)
    if not words:
        assert line.startswith("#")
        return
    assert words[0] == "torchplate"
    assert parser().parse_args(words[1:]).verb in VERBS


def test_a_verb_is_asked_what_it_takes_only_if_it_is_the_one():
    with pytest.raises(SystemExit):
        parser("new").parse_args(["run", "plate.yaml"])
    assert parser("run").parse_args(["run", "plate.yaml"]).config.name == "plate.yaml"


def test_help_waits_neither_for_torch_nor_for_any_other_package():
    code = "from torchplate.cli.main import main\ntry: main(['--help'])\nexcept SystemExit: pass"
    assert not modules_after(code) & {"torch", "numpy", "scipy", "matplotlib", "pydantic", "rich", "tensorboard"}


@pytest.mark.check
def test_a_model_is_loaded_without_what_only_reports_and_diagnoses_need():
    loaded = modules_after("import torchplate as tp\ntp.load_model, tp.read_measurement, tp.minimize")
    assert "torch" in loaded
    assert not loaded & {"matplotlib", "tensorboard", "rich", "scipy.signal", "scipy.stats", "torchplate.diagnosis"}


def test_every_public_name_is_there_and_so_are_the_rooms():
    for name in torchplate.__all__:
        assert getattr(torchplate, name) is not None
    code = "import torchplate\ntorchplate.search.minimize, torchplate.plate.Mesh"
    assert "torchplate.search" in modules_after(code)
    assert set(torchplate.__all__) <= set(dir(torchplate))


def test_a_name_that_is_not_public_is_said_to_be_absent():
    with pytest.raises(AttributeError, match="no attribute 'diagnos'"):
        _ = torchplate.diagnos


def test_the_public_names_are_those_that_type_checkers_see():
    import ast
    from pathlib import Path

    body = ast.parse(Path(torchplate.__file__).read_text()).body
    (typed,) = [node for node in body if isinstance(node, ast.If)]
    seen = {alias.name for node in typed.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert {*seen, "__version__"} == set(torchplate.__all__)
    homes = {
        name: node.module
        for node in typed.body
        if isinstance(node, ast.ImportFrom)
        for name in [a.name for a in node.names]
    }
    assert {name: f"torchplate.{room}" for name, room in torchplate._ROOM.items()} == homes


# What a command leaves in its environment is read by the libraries that it imports; torch keeps its number of threads.
THREADS = """
import os
from torchplate.cli.main import main
main(['effects'])
import torch
names = ('OPENBLAS_NUM_THREADS', 'OMP_WAIT_POLICY', 'GOMP_SPINCOUNT')
print([os.environ.get(name) for name in names], torch.get_num_threads())
"""


def threads_after(*arguments: str, **set_by_the_user: str) -> str:
    named = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
    environment = {name: value for name, value in os.environ.items() if name not in named} | set_by_the_user
    command = [sys.executable, "-c", THREADS.replace("['effects']", repr([*arguments] or ["effects"]))]
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return told.stdout.splitlines()[-1]


@pytest.mark.check
def test_threads_of_a_command_sleep_while_they_wait_and_torch_keeps_all_of_its_own():
    given = subprocess.run(
        [sys.executable, "-c", THREADS.replace("main(['effects'])", "")],
        env={name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()[-1]
    assert threads_after() == f"['1', 'PASSIVE', '1000'] {given}"


@pytest.mark.check
def test_threads_that_the_user_has_set_stay():
    assert threads_after(OMP_NUM_THREADS="1", OMP_WAIT_POLICY="ACTIVE") == "[None, 'ACTIVE', None] 1"
    assert threads_after(GOMP_SPINCOUNT="7").startswith("['1', 'PASSIVE', '7']")
    assert threads_after("diagnose", "no.yaml", OMP_NUM_THREADS="2").endswith(" 2")


@pytest.mark.check
@pytest.mark.parametrize("command", ["diagnose no.yaml", "plan no.yaml", "simulate no.yaml --out no.uff"])
def test_one_model_at_a_time_takes_one_thread_so_that_its_digits_hang_on_no_number_of_cores(command):
    assert threads_after(*command.split()).endswith(" 1")


@pytest.mark.check
@pytest.mark.parametrize("verb", ["diagnose", "plan"])
def test_a_diagnosis_takes_one_thread(verb):
    """It evaluates one model at a time; `plan` set its threads after torch had read them."""
    assert threads_after(verb, "no.yaml") == "['1', 'PASSIVE', '1000'] 1"
