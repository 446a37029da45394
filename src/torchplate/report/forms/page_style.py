"""How a report looks in a browser, on light and on dark ground, and on paper."""

from torchplate.report.figures.drawing import VARIABLES
from torchplate.report.figures.style import ON_DARK

_LIGHT = {"ink": "#1f2933", "muted": "#58646f", "rule": "#d9dee4", "tint": "#f4f6f8", "paper": "#ffffff"}
_LIGHT |= {"good": "#009e73", "half": "#e69f00", "bad": "#d55e00", "told": "#0072b2"}
_DARK = {"ink": "#e4e9ee", "muted": "#9dabb8", "rule": "#333d48", "tint": "#1d242c", "paper": "#14191f"}
_DARK |= {"good": "#2fc49e", "half": "#f0b429", "bad": "#ff8f4a", "told": "#4aa3e0"}


def style() -> str:
    """The page's style sheet; the colours of the figures are among its variables."""
    figures = {name.removeprefix("--"): colour for colour, name in VARIABLES.items()}
    on_dark = {VARIABLES[colour.lower()].removeprefix("--"): dark for colour, dark in ON_DARK.items()}
    light, dark = _variables(_LIGHT | figures), _variables(_DARK | on_dark)
    return f"""
:root {{ color-scheme: light dark; {light} --shade: none; }}
@media screen and (prefers-color-scheme: dark) {{
  :root {{ {dark} --shade: invert(0.92) hue-rotate(180deg); }}
}}
{_REST.strip()}""".strip()


def _variables(colours: dict[str, str]) -> str:
    return " ".join(f"--{name}: {colour};" for name, colour in colours.items())


_REST = """
:root { --side: clamp(0.8rem, 4vw, 1.5rem); --plot: "DejaVu Sans", Verdana, Arial, sans-serif; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, -apple-system, "Segoe UI",
  Roboto, "Helvetica Neue", Arial, "Noto Sans", sans-serif; -webkit-text-size-adjust: 100%; overflow-wrap: anywhere; }
main { max-width: 78rem; margin: 0 auto; padding: clamp(1rem, 4vw, 2.5rem) var(--side) 3rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 2.4rem 0 0.6rem; padding-top: 0.9rem;
  border-top: 1px solid var(--rule); }
h2 a { color: inherit; text-decoration: none; }
h2 a:hover::after, h2 a:focus::after { content: " #"; color: var(--muted); }
nav { display: flex; flex-wrap: wrap; gap: 0.2rem 1.1rem; font-size: 0.9rem; }
nav a { color: var(--muted); padding: 0.2rem 0; }
p, ul, ol { margin: 0.6rem 0; max-width: 46rem; }
ul, ol { padding-left: 1.4rem; }
li { margin: 0.3rem 0; }
li::marker { color: var(--muted); }
.verdict { max-width: none; margin: 0 0 1.4rem; padding: 0.9rem 1.1rem; font-size: 1.15rem; line-height: 1.45;
  background: var(--tint); border-left: 0.4rem solid var(--told); border-radius: 0 0.3rem 0.3rem 0; }
.verdict.consistent, .verdict.close { border-color: var(--good); }
.verdict.partly_explained, .verdict.partial { border-color: var(--half); }
.verdict.unexplained, .verdict.poor { border-color: var(--bad); }
.table { overflow-x: auto; margin: 0.9rem 0; overflow-wrap: normal; }
table { border-collapse: collapse; font-size: 0.9rem; line-height: 1.4; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--muted); font-size: 0.9rem; padding-bottom: 0.4rem; }
caption span { display: block; position: sticky; left: 0; max-width: min(46rem, calc(100vw - 2 * var(--side))); }
th, td { text-align: left; vertical-align: top; padding: 0.32rem 1.2rem 0.32rem 0;
  border-bottom: 1px solid var(--rule); font-weight: inherit; }
td:not(.number):not(.short), th[scope=row]:not(.short) { min-width: 11rem; }
thead th { white-space: nowrap; }
thead th { color: var(--muted); font-weight: 600; vertical-align: bottom; border-bottom: 1.5px solid var(--ink); }
td.number, th.number { text-align: right; }
td.number, td.short, th.short { white-space: nowrap; }
tr.marked td, tr.marked th { background: var(--tint); font-weight: 600; }
code, pre { font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  font-size: 0.9em; }
pre { background: var(--tint); padding: 0.7rem 1rem; border-radius: 0.3rem; white-space: pre-wrap;
  overflow-wrap: anywhere; }
figure { margin: 1.2rem 0; }
.panels { display: grid; gap: 1rem 1.2rem; grid-template-columns: repeat(auto-fill, minmax(min(100%, 20rem), 1fr)); }
.panels.small { grid-template-columns: repeat(auto-fill, minmax(min(46%, 10rem), 1fr)); gap: 0.5rem; }
.panel svg { display: block; max-width: 100%; height: auto; fill: var(--ink); }
.panel svg * { stroke-linejoin: round; stroke-linecap: butt; }
.panels .panel { max-width: 27rem; }
.panels .panel svg { width: 100%; }
.shaded, .panel svg image { filter: var(--shade); }
.narrow { display: none; }
@media (max-width: 48rem) {
  th, td { padding-right: 0.8rem; }
  caption span { width: calc(100vw - 2 * var(--side)); }
}
@media (max-width: 52rem) {
  .wide { display: none; }
  .narrow { display: block; }
  .narrow svg { width: 100%; max-width: 27rem; margin: 0 auto; }
}
@media screen and (max-width: 78rem) {
  td, th, thead th, td.short, th.short { white-space: normal; min-width: 0 !important; }
  th[scope=row] { overflow-wrap: anywhere; }
}
@media screen and (max-width: 34rem) {
  .folded table, .folded caption, .folded tbody { display: block; }
  .folded caption span { width: auto; }
  .folded thead { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
  .folded tr { display: flex; flex-wrap: wrap; gap: 0.25rem 1.1rem; padding: 0.5rem 0;
    border-bottom: 1px solid var(--rule); }
  .folded tr.marked { background: var(--tint); }
  .folded td, .folded th[scope=row] { display: block; padding: 0; border: 0; white-space: normal; text-align: left;
    min-width: 4.5rem !important; max-width: 100%; overflow-wrap: anywhere; }
  .folded th[scope=row] { flex: 0 0 100%; font-weight: 600; }
  .folded td:empty { display: none; }
  .folded td::before { content: attr(data-column); display: block; color: var(--muted); font-size: 0.78rem;
    font-weight: 400; line-height: 1.3; }
}
figcaption { color: var(--muted); font-size: 0.9rem; margin-top: 0.4rem; max-width: 46rem; }
footer { color: var(--muted); font-size: 0.85rem; margin-top: 2.5rem; padding-top: 0.8rem;
  border-top: 1px solid var(--rule); }
@page { margin: 16mm 15mm; }
@media print {
  body { font-size: 9.5pt; }
  table, caption, figcaption, footer { font-size: 8.5pt; }
  th, td { padding-right: 0.7rem; }
  td, th, thead th, td.short, th.short { white-space: normal; min-width: 0 !important; }
  h2 { margin-top: 1.6rem; }
  main { max-width: none; padding: 0; }
  nav { display: none; }
  h2, h2 + p, caption { break-after: avoid; }
  .panel, .either, tr, li, pre, .verdict { break-inside: avoid; }
  thead { display: table-header-group; }
  .table { overflow: visible; }
  th[scope=row] { overflow-wrap: anywhere; }
  caption span { width: auto; max-width: none; }
  .verdict, tr.marked td, tr.marked th, pre, svg { -webkit-print-color-adjust: exact; print-color-adjust: exact; }
  .panels { grid-template-columns: 1fr 1fr; }
  .panels.small { grid-template-columns: repeat(5, 1fr); }
  .wide { display: block; }
  .narrow { display: none; }
  .either svg { max-height: 225mm; margin: 0 auto; }
  .map svg { max-height: 140mm; width: auto; }
}
"""
