"""What a sensor did read, from files, and what can be said of it before any model is asked.

Map:
    measurement: FRFs by response and reference channel (`Measurement`, `Channel`), and their .npz archive
    natural_frequencies: a table of natural frequencies by mode number
    imperfections: what a test is not perfect in, and how large that is in a careful one
    read: one way in for every file; the suffix chooses the reader
    uff: universal files: dataset 58 (ASCII, binary) with nodes from 15 or 2411 and units from 164, read
    uff_values: the values of a dataset 58, in each of the format's eight cases
    uff_writer: a measurement written as a universal file
    level: kind and unit of the level from a file's own specifiers and labels
    noise: how noisy each line is, from the measurement alone
    placement: where each channel sits on the plate
    quality: driving points, reciprocity, coherence, noise between lines, peaks, suspicious channels
    plausibility: whether a model and a measurement can belong together: frequencies, kind and level
    analyser, modal_test: the virtual hammer test, which makes a measurement from a model
"""

from torchplate.measurement.analyser import ANALYSERS, Analyser
from torchplate.measurement.imperfections import CAREFUL, PERFECT, Imperfections
from torchplate.measurement.measurement import KINDS, SI_UNIT, Channel, Kind, Measurement, MeasurementError
from torchplate.measurement.modal_test import Hammer, hammer_test
from torchplate.measurement.natural_frequencies import NaturalFrequencies
from torchplate.measurement.placement import Match, Placement, place
from torchplate.measurement.quality import Quality, assess
from torchplate.measurement.read import read_measurement
from torchplate.measurement.uff import read_uff
from torchplate.measurement.uff_writer import write_uff

__all__ = [
    "ANALYSERS",
    "CAREFUL",
    "KINDS",
    "PERFECT",
    "SI_UNIT",
    "Analyser",
    "Channel",
    "Hammer",
    "Imperfections",
    "Kind",
    "Match",
    "Measurement",
    "MeasurementError",
    "NaturalFrequencies",
    "Placement",
    "Quality",
    "assess",
    "hammer_test",
    "place",
    "read_measurement",
    "read_uff",
    "write_uff",
]
