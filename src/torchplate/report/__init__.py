"""Results as people read them: one content in Markdown, in one HTML file and in figures. Nothing here writes a file.

- `blocks`: what a report is made of; `figures`: what is drawn in it; `forms`: Markdown, HTML and LaTeX.
- `diagnosis`: the report of a diagnosis; `verdict`: its first sentence; `diagnosis_tables`: its tables;
  `diagnosis_figures`: its figures.
- `run`: the report of a run; `run_figures`: its figures.
- `comparison`: searches beside each other.
"""

from torchplate.report.blocks.document import Table
from torchplate.report.comparison import WITHIN, Compared, comparison_report, comparison_tables
from torchplate.report.diagnosis import diagnosis_report
from torchplate.report.diagnosis_figures import log_figures
from torchplate.report.figures.drawing import lay_out, png
from torchplate.report.figures.gap import step_tags
from torchplate.report.figures.quality import quality_figure
from torchplate.report.run import frf_figures, model_report, run_report
from torchplate.report.run_figures import Convergence, convergence
from torchplate.report.verdict import verdict_sentence

__all__ = [
    "WITHIN",
    "Compared",
    "Convergence",
    "Table",
    "comparison_report",
    "comparison_tables",
    "convergence",
    "diagnosis_report",
    "frf_figures",
    "lay_out",
    "log_figures",
    "model_report",
    "png",
    "quality_figure",
    "run_report",
    "step_tags",
    "verdict_sentence",
]
