"""A figure as a picture: PNG or PDF for a file of its own, SVG that takes the colours of the page it stands in."""

import html
import io
import re
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure
from PIL import Image

from torchplate.report.figures.style import ON_DARK, SHADED

DPI = 150
"""Of figures that are to be sharp on paper."""
_SVG: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: sharp, small, and found by a search in the page
    "path.simplify_threshold": 0.2,  # [px] of 72 to the inch
    "font.family": "DejaVu Sans",
}
_PDF: dict[Any, Any] = {"pdf.fonttype": 42, "font.family": "DejaVu Sans"}
_NO_METADATA = dict.fromkeys(("Creator", "Date", "Format", "Type"))
VARIABLES = {colour.lower(): f"--c{turn}" for turn, colour in enumerate(ON_DARK)}
"""A name in the page's style for each colour of a figure."""


def png(figure: Figure, dpi: int = DPI, n_colour: int = 128) -> bytes:
    """A figure as a PNG of few colours, a third of the size."""
    whole, small = io.BytesIO(), io.BytesIO()
    lay_out(figure)
    figure.savefig(whole, format="png", dpi=dpi)
    with Image.open(whole) as image:
        image.convert("RGB").quantize(n_colour).save(small, format="png", optimize=True)
    return small.getvalue()


def pdf(figure: Figure) -> bytes:
    """A figure for paper: its text is text, and the same figure is the same file."""
    drawn = io.BytesIO()
    with mpl.rc_context(_PDF):
        lay_out(figure)
        figure.savefig(drawn, format="pdf", metadata={"CreationDate": None})
    return drawn.getvalue()


def svg(figure: Figure, name: str, told: str) -> str:
    """A figure as an element of an HTML page.

    Its colours are the page's, by the names of VARIABLES; what it marks as SHADED is a class.

    Args:
        figure: it.
        name: of it on this page, so that no two figures have a clip path or a marker of one name.
        told: what it shows, in words.
    """
    drawn = io.StringIO()
    with mpl.rc_context(_SVG | {"svg.hashsalt": name}):
        lay_out(figure)
        figure.savefig(drawn, format="svg", metadata=_NO_METADATA)
    text = drawn.getvalue()
    text = text[text.index("<svg") :]
    head, _, body = text.partition(">")
    box = re.search(r'viewBox="[^"]+"', head)
    assert box is not None
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.S)
    body = re.sub(r'(?<=[ "])xlink:(?=href=)', "", body)
    body = re.sub(rf'<g id="{SHADED}[^"]*"', f'<g class="{SHADED}"', body)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    body = re.sub(r"font: ([^;\"']*)'DejaVu Sans'[^;\"]*", r"font: \1var(--plot)", body)
    body = re.sub(r"#[0-9a-f]{6}\b", lambda found: _variable(found[0]), body)
    body = re.sub(r'(?<= d=")[^"]*', lambda found: re.sub(r"(?<=\.\d\d)\d+", "", found[0]), body)
    width = float(box[0].split()[2])
    return f'<svg role="img" aria-label="{html.escape(told)}" {box[0]} width="{4 / 3 * width:.0f}">{body.strip()}'


def lay_out(figure: Figure) -> None:
    """Lay a figure out once. While it has an engine, be it one that does nothing, saving it draws it twice.

    Where an axis has no label, a place is told for it: else all its ticks are laid out several times more to find one.
    """
    for axes in figure.axes:
        for axis, place in ((axes.xaxis, (0.5, 0.0)), (axes.yaxis, (0.0, 0.5))):
            if not axis.label.get_text():
                axis.set_label_coords(*place)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
            figure.set_layout_engine(None)


def _variable(colour: str) -> str:
    return f"var({VARIABLES[colour]})" if colour in VARIABLES else colour
