"""`torchplate effects`: the catalogue, printed."""

from collections.abc import Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table

from torchplate.cli.config import InputError
from torchplate.cli.progress.console import speaking
from torchplate.effects import CATALOGUE, find_effect, options


def effects(names: Sequence[str] = (), console: Console | None = None) -> None:
    """Print what each effect shows, its parameters and where a search looks for them.

    Args:
        names: of the effects; all if left out.
        console: where the table goes.

    Raises:
        InputError: if the catalogue holds no effect of a name.
    """
    console = console or speaking()
    try:
        chosen = [find_effect(name) for name in names] or list(CATALOGUE.values())
    except KeyError as error:
        raise InputError(str(error.args[0])) from None
    for effect in chosen:
        console.print(f"[bold]{effect.name}[/]  acts on {', '.join(sorted(effect.acts_on))}")
        console.print(Padding(effect.shows, (0, 0, 0, 2), expand=False))
        table = Table(box=None, show_header=False, padding=(0, 2))
        for wrapped in (False, False, False, True, True):
            table.add_column(no_wrap=not wrapped)
        for option in options(effect):
            table.add_row(option, "", "", "", "fixed, never searched")
        for key, parameter in effect.parameters.items():
            neutral = "" if parameter.neutral is None else f"neutral {parameter.neutral:g}"
            table.add_row(key, rf"\[{parameter.unit}]", neutral, parameter.looked_for, parameter.meaning)
        console.print(table)
    console.print("A, h, ρ, D: area, thickness, density and bending rigidity of the plate as it is in the model")
