"""Which of the candidates that were scored are refitted."""

import torch

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.selection.screen import Scored
from torchplate.diagnosis.selection.shortlist import contained, promising
from torchplate.diagnosis.settings import SETTINGS
from torchplate.effects import CATALOGUE

NONE = torch.zeros(0)


def scored(name: str, drop: float, turn: int) -> Scored:
    """An effect that promises so much, parallel to no other."""
    signature = torch.eye(9, dtype=torch.float64)[turn]
    candidate = Candidate(CATALOGUE[name](), {}, {}, {})
    return Scored(candidate, f"{name}_1", None, drop, {}, NONE, signature, NONE)  # type: ignore[arg-type]


PROMISES = [
    scored("absorber", 0.6, 0),
    scored("thickness_taper", 0.5, 1),
    scored("density", 0.4, 2),
    scored("ground_dashpot", 0.3, 3),
    scored("point_mass", 0.001, 4),
]


def test_what_an_effect_becomes_at_an_end_of_its_parameters_is_refitted_before_it():
    """However little that promises: a spring with a mass that stays where it is takes all that a spring would."""
    names = [one.candidate.name for one in promising(PROMISES, 2, SETTINGS.screening)]
    assert names == ["point_mass", "ground_dashpot", "absorber", "thickness_taper"]


def test_what_is_simpler_is_named_by_the_effect_and_has_a_place_too():
    for effect in CATALOGUE.values():
        for name in effect.contains:
            assert name in CATALOGUE
            # Fewer numbers to be fitted, or it would not be simpler.
            assert len(CATALOGUE[name].parameters) < len(effect.parameters)
    assert contained(PROMISES[0].candidate, {"ground_spring", "density"}) == ["ground_spring"]
