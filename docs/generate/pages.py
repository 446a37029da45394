"""Pages of the documentation that are made from the code, so that they cannot drift from it.

`python docs/generate/pages.py FOLDER` writes them without the site.
"""

import argparse
import ast
import inspect
import re
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from benchmarks import benchmarks
from of_tests import module_of_tests
from signature import draw, signature

import torchplate
from torchplate.cli.arguments import VERBS
from torchplate.cli.main import parser
from torchplate.cli.schema import EFFECT_PAGE, KEY_PAGE
from torchplate.cli.verbs.keys import Key, Section, sections
from torchplate.effects import CATALOGUE, Effect, options

ROOT = Path(__file__).parents[2]
CONFIGURATION = """\
Every key of a config, from the models that check it. `torchplate keys` prints the same, `torchplate keys mesh` a part
of it; `--set mesh.refine=2` overrides a key of the file."""
EFFECTS = """\
The catalogue, from the class bodies. `torchplate effects` prints it without pictures.

Each picture is of an aluminium plate, 410 × 290 × 3.1 mm, on two soft springs: grey without the effect, orange with it,
at the values of the table's last column. Left, the accelerance from node 8, (0.7, 0) of the sides, to node 3, (0.2, 0);
right, by how much each natural frequency moves, or, where none does, by how much the phase is turned. Modes are counted
from 1, the three of the rigid plate on its springs included."""
CLAIMS = """\
What the tests prove, in their own words: each line is the name of a test, which runs or says why it cannot (no GPU,
measured files absent). [Verification](verification.md) has the sources."""
# The catalogue's headings, and which effects stand under each: those that act on one of these and are under none below.
GROUPS = {
    "The plate itself": {"section", "geometry"},
    "Damping": {"damping"},
    "Added at places": {"mass", "stiffness"},
    "The sensor chain": {"sensor chain"},
    "The mesh": {"discretisation"},
}


def configuration() -> str:
    """Every key of a config."""
    lines = [
        f"# {KEY_PAGE}",
        "",
        CONFIGURATION,
        "",
    ]
    for place, section in sections().items():
        depth = "##" if "." not in place else "###"
        title = {"config": "The whole file", "numbers": "Numbers and intervals"}.get(place, f"`{place}`")
        lines += [f"{depth} {title} {{#{place.replace('.', '-')}}}", "", section.about, "", *_keys(section), ""]
        if place == "effects":
            lines += ["The page [Effects](effects.md) has all of them.", ""]
    return "\n".join(lines)


def _keys(section: Section) -> list[str]:
    def row(key: Key) -> str:
        cells = (
            f"`{key.name}`",
            key.kind,
            key.unit,
            f"`{key.default}`",
            escape(key.meaning, quote=False),
            f"`{key.example}`",
        )
        return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"

    table = [
        "| key | value | unit | default | meaning | example |",
        "|---|---|---|---|---|---|",
        *map(row, section.keys),
    ]
    choices = [f"| `{name}` | {meaning.replace('|', '&#124;')} |" for name, meaning in section.choices.items()]
    return [*table, "", "| name | |", "|---|---|", *choices] if choices else table


def examples() -> Mapping[str, Any]:
    """Options and values of each effect that a test can see, from the tests' own list."""
    return dict(module_of_tests("effects/conftest.py").EXAMPLES)


def twins(name: str) -> list[tuple[str, str]]:
    """Effects that pass for this one in principle, and why, from the table that blind tests are judged by."""
    table = module_of_tests("blind/twins.py").TABLE
    pairs = [(pair, {pair.one, pair.other} - {name}) for pair in table if name in (pair.one, pair.other)]
    return [(other, pair.why) for pair, others in pairs for other in others]


def effects(names: Sequence[str] = tuple(CATALOGUE)) -> str:
    """The catalogue, each effect with its signature drawn."""
    shown = examples()
    lines = [f"# {EFFECT_PAGE}", "", EFFECTS, ""]
    if missing := set(names) - set(shown):
        raise KeyError(f"No example of {', '.join(missing)}. Add one to EXAMPLES in tests/effects/conftest.py.")
    chosen = [CATALOGUE[name] for name in names]
    for title in (*GROUPS, "Others"):
        group = [effect for effect in chosen if _group(effect) == title]
        lines += [f"## {title}", ""] if group else []
        for effect in group:
            lines += _effect(effect, shown[effect.name].options, shown[effect.name].value)
    lines += ["A, h, ρ, D: area, thickness, density and bending rigidity of the plate as it is in the model.", ""]
    return "\n".join(lines)


def _group(effect: type[Effect]) -> str:
    return next((title for title, acts_on in reversed(GROUPS.items()) if effect.acts_on & acts_on), "Others")


def _effect(effect: type[Effect], fixed: Mapping[str, Any], value: Mapping[str, float]) -> list[str]:
    parameters = effect(**fixed).parameters
    told = _paragraphs(effect)
    lines = [f"### `{effect.name}` {{#{effect.name}}}", "", effect.shows, ""]
    lines += [draw(signature(effect, dict(fixed), dict(value))), ""]
    rows = [
        f"| `{name}` | | an option, never searched | | | `{fixed.get(name, 'its default')}` |"
        for name in options(effect)
    ]
    for name, one in parameters.items():
        neutral = "required" if one.neutral is None else f"{one.neutral:g}"
        rows.append(
            f"| `{name}` | {one.unit} | {one.meaning}; {one.allowed} | {neutral} | {one.looked_for} | {value[name]:g} |"
        )
    if rows:
        lines += [
            "| parameter | unit | meaning and range | neutral | looked for in | in the picture |",
            "|---|---|---|---|---|---|",
        ]
        lines += [*rows, ""]
    lines += [f"- **Acts on** {', '.join(sorted(effect.acts_on))}."]
    lines += [f"- **Passes for** [`{other}`](#{other}): {why}" for other, why in twins(effect.name)]
    if effect.check is not None:
        lines += [f"- **What tells it apart**: {effect.check.action} (cost {effect.check.cost} of 5)."]
    lines += [f"- **As implemented**: {told}", f"- **Source**: {effect.source}.", ""]
    return lines


def _paragraphs(effect: type[Effect]) -> str:
    """The class docstring without its sections."""
    text = inspect.getdoc(effect) or ""
    return " ".join(re.split(r"\n(?:Args|Raises|Attributes):", text)[0].split())


def commands() -> str:
    """The command line: what each verb takes, with an example."""
    lines = ["# Commands", "", "What `torchplate VERB --help` prints.", ""]
    whole = parser()
    (verbs,) = (action for action in whole._actions if isinstance(action, argparse._SubParsersAction))
    for name, verb in VERBS.items():
        own: argparse.ArgumentParser = verbs.choices[name]
        lines += [
            f"## `torchplate {name}` {{#{name}}}",
            "",
            _capitalised(verb.summary) + ".",
            "",
            "```sh",
            *verb.examples,
            "```",
            "",
        ]
        lines += ["| argument | meaning |", "|---|---|"]
        for action in own._actions:
            if action.dest == "help":
                continue
            words = ", ".join(action.option_strings) or str(action.metavar or action.dest)
            if action.option_strings and action.nargs != 0:
                named = f"{{{','.join(action.choices)}}}" if action.choices else action.dest.upper()
                metavar = action.metavar or named
                words += " " + (metavar if isinstance(metavar, str) else " ".join(metavar))
            needed = " (required)" if action.required and action.option_strings else ""
            lines.append(f"| `{words}`{needed} | {escape(action.help or '', quote=False)} |")
        lines.append("")
    return "\n".join(lines)


def python() -> str:
    """The public names, by their own docstrings."""
    lines = ["# Python", "", "What `import torchplate as tp` offers, by each name's own words.", ""]
    for name in torchplate.__all__:
        value = getattr(torchplate, name)
        if name.startswith("_"):
            continue
        if not callable(value):
            lines += [f"## `tp.{name}` {{#{name}}}", "", f"A registry: `{'`, `'.join(map(str, value))}`.", ""]
            continue
        lines += [f"## `tp.{name}` {{#{name}}}", "", "```text", f"{name}{_signature(value)}", "```", ""]
        lines += ["```text", inspect.getdoc(value) or "", "```", ""]
    return "\n".join(lines)


def _signature(value: Callable[..., Any]) -> str:
    """As a reader types it: without the annotations, which the docstring explains."""
    try:
        found = inspect.signature(value)
    except (TypeError, ValueError):
        return "(...)"
    bare = [one.replace(annotation=inspect.Parameter.empty) for one in found.parameters.values()]
    return str(found.replace(parameters=bare, return_annotation=inspect.Signature.empty))


def claims() -> str:
    """Every claim that a test proves, room by room: the names of the tests are sentences."""
    lines = [
        "# Claims",
        "",
        CLAIMS,
        "",
    ]
    total = 0
    for room in sorted(path for path in (ROOT / "tests").iterdir() if path.is_dir()):
        found = [(path.stem, _claims(path)) for path in sorted(room.glob("test_*.py"))]
        found = [(stem, said) for stem, said in found if said]
        if not found:
            continue
        lines += [f"## {_capitalised(room.name)} {{#claims-{room.name}}}", ""]
        for stem, said in found:
            lines += [f"### {stem.removeprefix('test_').replace('_', ' ')} {{#claims-{room.name}-{stem}}}", ""]
            lines += [f"- {sentence}" for sentence in said] + [""]
            total += len(said)
    lines[2] = f"{total} claims. " + lines[2]
    return "\n".join(lines)


def _claims(path: Path) -> list[str]:
    tree = ast.parse(path.read_text())
    names = [
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    return [_capitalised(name.removeprefix("test_").replace("_", " ")) for name in names]


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]


PAGES: Mapping[str, Callable[[], str]] = {
    "configuration.md": configuration,
    "effects.md": effects,
    "commands.md": commands,
    "python.md": python,
    "claims.md": claims,
    "benchmarks.md": benchmarks,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Write them into a folder."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("folder", type=Path)
    folder = words.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, page in PAGES.items():
        (folder / name).write_text(page())


if __name__ == "__main__":
    main()
