"""Results as people read them: one content in Markdown, in one HTML file and in figures. Nothing here writes a file.

- `document`: the blocks a report is made of; `markdown`, `page`: the two forms of it; `page_style`: how it looks.
- `numbers`: values with their errors; `channel_names`: what "3w" says.
- `diagnosis`: the report of a diagnosis; `verdict`: its first sentence; `diagnosis_tables`: its tables;
  `diagnosis_figures`: its figures.
- `gap_figure`, `bands_figure`, `frf_figure`, `plate_map`, `field_map`, `assurance_figure`: what each of them shows.
- `mode_shapes`: small multiples of a model's modes; `measured_shapes`: what was measured beside them;
  `shape_agreement`: MAC and COMAC of shapes that were measured as such, `modal_fdac`: the shapes between their
  resonances, `paired_shapes`: both with the model's beside them.
- `quality_figure`: a measurement as it is.
- `run`: the report of a run; `run_figures`: its figures.
- `comparison`: searches beside each other; `latex`: its tables for a paper.
- `style`: colours, curves and axes that all figures share; `drawing`: a figure as a picture.
"""

from torchplate.report.comparison import WITHIN, Compared, comparison_report, comparison_tables
from torchplate.report.diagnosis import diagnosis_report
from torchplate.report.diagnosis_figures import log_figures
from torchplate.report.document import Table
from torchplate.report.drawing import lay_out, png
from torchplate.report.gap_figure import step_tags
from torchplate.report.quality_figure import quality_figure
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
