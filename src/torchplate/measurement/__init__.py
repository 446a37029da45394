"""What a sensor did read, from files, and what can be said of it before any model is asked.

- `measurement`: FRFs by response and reference channel (`Measurement`, `Channel`), and their .npz archive;
  `natural_frequencies`: a table of natural frequencies by mode number; `modal`: modal models.
- `imperfections`: what a test is not perfect in, and how large that is in a careful one.
- `level`: kind and unit of a level, from a file's own specifiers and labels.
- `read`: one way in for every file; the suffix chooses the reader.
- `formats`: arrays and text of a file, whoever wrote it; `uff`: universal files; `records`: time records of hits, and
  FRFs, in files that name no nodes.
- `points`: where the points of a test lie, in its file and on the plate.
- `assessment`: what can be said of a measurement before a model is fitted to it, its noise above all.
- `virtual`: hammer tests of a model.
"""

from torchplate.measurement.assessment.noise import Noise, noise_level
from torchplate.measurement.assessment.plausibility import disagreements
from torchplate.measurement.assessment.quality import Quality, assess, peak_width, peaks, summed_amplitude
from torchplate.measurement.assessment.resonances import Resonances
from torchplate.measurement.formats.archive import plain
from torchplate.measurement.imperfections import CAREFUL, PERFECT, Imperfections
from torchplate.measurement.measurement import KINDS, SI_UNIT, Channel, Kind, Measurement, MeasurementError
from torchplate.measurement.modal.analysis import Analysed, modes
from torchplate.measurement.modal.model import ModalModel, is_modal_table, read_modal_table
from torchplate.measurement.natural_frequencies import SCATTER, NaturalFrequencies, assumed, with_std
from torchplate.measurement.points.frame import METRES, Frame, in_frame
from torchplate.measurement.points.nodes import NodeTable, read_node_table, read_nodes, with_node_table, with_nodes
from torchplate.measurement.points.placement import Match, Placement, place, place_points
from torchplate.measurement.points.proposal import Proposal, Said, propose
from torchplate.measurement.read import (
    FRF_SUFFIX,
    MODAL_SUFFIX,
    UFF_SUFFIX,
    read_measurement,
    read_modal_model,
    write_modal_model,
)
from torchplate.measurement.records.estimate import ESTIMATES, Estimate, Windows, estimate
from torchplate.measurement.records.frf_tables import FrfTable, frfs_of_tables, read_frf_table
from torchplate.measurement.records.readers import Layout, read_recordings
from torchplate.measurement.records.recording import Cutting, Hits, Recording, cut
from torchplate.measurement.records.tables import RECORD_SUFFIX
from torchplate.measurement.records.whole_test import frf_of_hits
from torchplate.measurement.uff.contents import Contents, Part, describe
from torchplate.measurement.uff.frfs import read_uff
from torchplate.measurement.uff.geometry import read_geometry
from torchplate.measurement.uff.writer import write_uff
from torchplate.measurement.virtual.analyser import ANALYSERS, Analyser, Spectra
from torchplate.measurement.virtual.hammer_test import Hammer, hammer_test
from torchplate.measurement.virtual.simulation import simulate

__all__ = [
    "ANALYSERS",
    "CAREFUL",
    "ESTIMATES",
    "FRF_SUFFIX",
    "KINDS",
    "METRES",
    "MODAL_SUFFIX",
    "PERFECT",
    "RECORD_SUFFIX",
    "SCATTER",
    "SI_UNIT",
    "UFF_SUFFIX",
    "Analysed",
    "Analyser",
    "Channel",
    "Contents",
    "Cutting",
    "Estimate",
    "Frame",
    "FrfTable",
    "Hammer",
    "Hits",
    "Imperfections",
    "Kind",
    "Layout",
    "Match",
    "Measurement",
    "MeasurementError",
    "ModalModel",
    "NaturalFrequencies",
    "NodeTable",
    "Noise",
    "Part",
    "Placement",
    "Proposal",
    "Quality",
    "Recording",
    "Resonances",
    "Said",
    "Spectra",
    "Windows",
    "assess",
    "assumed",
    "cut",
    "describe",
    "disagreements",
    "estimate",
    "frf_of_hits",
    "frfs_of_tables",
    "hammer_test",
    "in_frame",
    "is_modal_table",
    "modes",
    "noise_level",
    "peak_width",
    "peaks",
    "place",
    "place_points",
    "plain",
    "propose",
    "read_frf_table",
    "read_geometry",
    "read_measurement",
    "read_modal_model",
    "read_modal_table",
    "read_node_table",
    "read_nodes",
    "read_recordings",
    "read_uff",
    "simulate",
    "summed_amplitude",
    "with_node_table",
    "with_nodes",
    "with_std",
    "write_modal_model",
    "write_uff",
]
