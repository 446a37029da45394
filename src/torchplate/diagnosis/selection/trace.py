"""Where forward selection stands, and everything that it has fitted."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from torchplate.diagnosis.candidates.candidate import Candidate
from torchplate.diagnosis.judged import Fit
from torchplate.diagnosis.model_builder import ModelBuilder
from torchplate.diagnosis.problem import Prior
from torchplate.diagnosis.selection.criterion import Choice, Hypothesis, remaining
from torchplate.diagnosis.selection.screen import Scored
from torchplate.measurement import Noise
from torchplate.model import PlateModel


@dataclass(frozen=True)
class State:
    """Where forward selection stands.

    Attributes:
        model: the given one with the effects named so far, in all dofs.
        fit: of it.
        named: the effects, with what was known when each was named.
        previous: before the last of them was added.
        ranked: the catalogue, from which the last of them was named.
    """

    model: PlateModel
    fit: Fit
    named: tuple["Naming", ...] = ()
    previous: "State | None" = None
    ranked: "Ranked | None" = None


@dataclass(frozen=True)
class Naming:
    """An effect that was added, and why.

    Attributes:
        hypothesis: as it was named.
        choice: that was made then.
        before: the fit that it was added to.
        rivals: everything that was refitted then.
        again: the choice as it is once later effects are known; None where nothing was named after it.
        by_chance: what chance lets the best of the catalogue take once in a hundred.
    """

    hypothesis: Hypothesis
    choice: Choice
    before: Fit
    rivals: tuple[Hypothesis, ...] = ()
    again: Choice | None = None
    by_chance: float = 0.0

    @property
    def known(self) -> Choice:
        """The choice as it is known last."""
        return self.again or self.choice

    def confidence(self, final: Fit, explained: bool) -> float:
        """Posterior probability of the set; of what the last model leaves unexplained it accounts for nothing.

        What is left is that beside the specimen as it was found: a uniform plate's gap says nothing of a name where
        peaks are narrower than a section wanders, nor does any gap of what nuisances had taken on.

        Args:
            final: the last model's fit.
            explained: whether that leaves nothing but noise and nuisances.
        """
        share = 1.0 if explained else max(0.0, 1 - remaining(self.before, final))
        return self.known.confidence * share


@dataclass(frozen=True)
class Trace:
    """Everything that was fitted.

    Attributes:
        builder: what evaluated the models.
        noise: of the FRFs.
        given: the fit of the given model on its own mesh.
        baseline: the given model on a mesh whose error is taken off.
        final: the last model.
        rankings: of the catalogue, in the order they were made.
        prior: what was known of the parameters beforehand.
        unrefined: the last model on the given mesh; None where nothing was named, or an edge is held.
    """

    builder: ModelBuilder
    noise: Noise
    given: Fit
    baseline: State
    final: State
    rankings: tuple["Ranked", ...]
    prior: Prior
    unrefined: Fit | None = None


@dataclass(frozen=True)
class Ranked:
    """The catalogue, ranked beside one model.

    Attributes:
        promises: the score test.
        hypotheses: what was refitted.
        by_chance: what chance lets the best of the catalogue take from the sum of squares once in a hundred; 0 where so
            much is left that it was not asked.
        far: names that were fitted beside the frequency axis alone, where they stayed far above the best.
        square: that the promises are parts of, where they were asked on a finer mesh and nothing was refitted; else 0.
        ways: candidates where they ended beside the frequency axis, on the unit cube, the nearest first.
    """

    promises: tuple[Scored, ...]
    hypotheses: tuple[Hypothesis, ...]
    by_chance: float = 0.0
    far: frozenset[str] = frozenset()
    square: float = 0.0
    ways: tuple[tuple[Candidate, Tensor], ...] = ()

    def allowed(self, one: Scored) -> float:
        """What chance and the mesh would let an effect take from the sum of squares.

        What it takes is the square of a projection, and those of noise and of the mesh add up at worst.
        """
        return (math.sqrt(one.by_chance_at_most or self.by_chance) + math.sqrt(one.by_mesh)) ** 2

    def chance(self, name: str) -> float:
        """What chance lets an effect take from −2 ln L; that of the best of all where it was not scored by itself."""
        return chance_of(self.promises, name, self.by_chance)

    def exceeds(self, one: Scored) -> float:
        """What an effect promises on a finer mesh over what chance and the mesh would let it take."""
        return one.drop * self.square / max(self.allowed(one), 1e-300)

    @property
    def most_beyond(self) -> Scored | None:
        """The effect of which that is largest."""
        return max(self.promises, key=self.exceeds, default=None)


def chance_of(promises: Sequence[Scored], name: str, best: float) -> float:
    """What chance lets an effect take from −2 ln L.

    Args:
        promises: of the score test.
        name: of the effect, whose options are all asked.
        best: what it lets the best of all take, which counts where the effect was not scored by itself.
    """
    return max((one.by_chance_at_most for one in promises if one.candidate.name == name), default=0.0) or best
