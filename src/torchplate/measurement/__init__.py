"""What a sensor did read, from files, and what can be said of it before any model is asked.

Map:
    measurement: FRFs by response and reference channel (`Measurement`, `Channel`), and their .npz archive
    natural_frequencies: a table of natural frequencies by mode number
    imperfections: what a test is not perfect in, and how large that is in a careful one
    read: one way in for every file; the suffix chooses the reader
    archive, parsing: arrays and text of a file, whoever wrote it; what a broken one raises becomes one sentence
    uff: FRFs and coherence of a universal file as one measurement
    uff_file: a universal file dataset by dataset: 58 (ASCII, binary)
    uff_geometry: its units (164) and nodes (15 or 2411)
    coordinate_system: those of datasets 18 and 2420, and the way from them to the global one
    contents: what a universal file holds, dataset by dataset, and what can be done with it
    uff_values: the values of a dataset 58, in each of the format's eight cases
    uff_writer: a measurement written as a universal file
    level: kind and unit of the level from a file's own specifiers and labels
    noise: how noisy each line is, from the measurement alone
    resonances: poles and residues that this finds, between the lines and beside the axis too
    rational_fit: FRFs as rational functions with common poles, and what they leave
    noise_regression: the two components of a noise, from what is left
    placement: where each channel sits on the plate
    frame: where the plate lies in the file's coordinates
    nodes: a table of coordinates, for files without any
    node_heads: the unit of length that the head of such a table states
    geometry: sides, axes and unit of the plate, proposed from the points of a test
    quality: driving points, reciprocity, coherence, noise between lines, peaks, suspicious channels
    plausibility: whether a model and a measurement can belong together: frequencies, kind and level
    recording: time records of hits, cut and checked
    record_files: time records from files of any kind, with the nodes that belong to them
    frf_tables: FRFs in tables that name no nodes, from MAT, NPZ, CSV and text
    text_table: cells, units and numbers of a table that is text
    record_tables: tables of channels from WAV, MAT, NPZ, CSV and LVM files
    mat_elements: what a MAT file holds, walked before SciPy reads it
    estimate: FRFs and coherence from cut hits
    from_hits: recordings of a whole test as one measurement
    modal_model: natural frequencies, damping and mode shapes at points (`ModalModel`), and their table
    modal_uff: the same from datasets 55 and 2414, and written as 55
    modal_analysis: the same estimated from FRFs
    analyser, modal_test: the virtual hammer test, which makes a measurement from a model
    simulation: the same of a model without its mesh error (`simulate`)
"""

from torchplate.measurement.analyser import ANALYSERS, Analyser, Spectra
from torchplate.measurement.archive import plain
from torchplate.measurement.contents import Contents, Part, describe
from torchplate.measurement.estimate import ESTIMATES, Estimate, Windows, estimate
from torchplate.measurement.frame import METRES, Frame, in_frame
from torchplate.measurement.frf_tables import FrfTable, frfs_of_tables, read_frf_table
from torchplate.measurement.from_hits import frf_of_hits
from torchplate.measurement.geometry import Proposal, Said, propose
from torchplate.measurement.imperfections import CAREFUL, PERFECT, Imperfections
from torchplate.measurement.measurement import KINDS, SI_UNIT, Channel, Kind, Measurement, MeasurementError
from torchplate.measurement.modal_analysis import Analysed, modes
from torchplate.measurement.modal_model import ModalModel, is_modal_table, read_modal_table
from torchplate.measurement.modal_test import Hammer, hammer_test
from torchplate.measurement.natural_frequencies import SCATTER, NaturalFrequencies, assumed, with_std
from torchplate.measurement.nodes import NodeTable, read_node_table, read_nodes, with_node_table, with_nodes
from torchplate.measurement.noise import Noise, noise_level
from torchplate.measurement.placement import Match, Placement, place, place_points
from torchplate.measurement.plausibility import disagreements
from torchplate.measurement.quality import Quality, assess, peak_width, peaks, summed_amplitude
from torchplate.measurement.read import (
    FRF_SUFFIX,
    MODAL_SUFFIX,
    UFF_SUFFIX,
    read_measurement,
    read_modal_model,
    write_modal_model,
)
from torchplate.measurement.record_files import Layout, read_recordings
from torchplate.measurement.record_tables import RECORD_SUFFIX
from torchplate.measurement.recording import Cutting, Hits, Recording, cut
from torchplate.measurement.resonances import Resonances
from torchplate.measurement.simulation import simulate
from torchplate.measurement.uff import read_uff
from torchplate.measurement.uff_geometry import read_geometry
from torchplate.measurement.uff_writer import write_uff

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
