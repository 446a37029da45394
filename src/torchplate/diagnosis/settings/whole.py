"""All settings of a diagnosis, by stage."""

from dataclasses import dataclass, field

from torchplate.diagnosis.settings.evidence import Comparison, HoldingOut, Lines, Localising
from torchplate.diagnosis.settings.field import FieldInference
from torchplate.diagnosis.settings.fitting import Fitting, Meshes, Searching, WideLevels
from torchplate.diagnosis.settings.selection import Screening, Selecting, Trials
from torchplate.discrepancy import Knowledge, Wandering


@dataclass(frozen=True)
class DiagnosisSettings:
    """All of them, by stage.

    Args:
        knowledge: how well noise and nuisances are known.
        wandering: of the plate's section.
        comparison: of hypotheses.
        lines: how many are looked at.
        holding_out: FRFs that no fit sees.
        meshes: and bases.
        wide: levels.
        fitting: at the sharp one.
        searching: the box.
        trials: of each candidate.
        screening: of all candidates.
        selecting: of those refitted.
        localising: the misfit.
        inferring: a field, where nothing of the catalogue accounts for it.
    """

    knowledge: Knowledge = field(default_factory=Knowledge)
    wandering: Wandering = field(default_factory=Wandering)
    comparison: Comparison = field(default_factory=Comparison)
    lines: Lines = field(default_factory=Lines)
    holding_out: HoldingOut = field(default_factory=HoldingOut)
    meshes: Meshes = field(default_factory=Meshes)
    wide: WideLevels = field(default_factory=WideLevels)
    fitting: Fitting = field(default_factory=Fitting)
    searching: Searching = field(default_factory=Searching)
    trials: Trials = field(default_factory=Trials)
    screening: Screening = field(default_factory=Screening)
    selecting: Selecting = field(default_factory=Selecting)
    localising: Localising = field(default_factory=Localising)
    inferring: FieldInference = field(default_factory=FieldInference)


# What is read where no target says otherwise.
SETTINGS = DiagnosisSettings()
