"""What a table leaves without a name, and what is remarked beside the verdict."""

import math

from torchplate.diagnosis.settings import SETTINGS
from torchplate.diagnosis.table.found import Found, pressed_out
from torchplate.diagnosis.table.null import once_in_a_hundred
from torchplate.notation import percent


def missing_still(found: Found) -> tuple[str, ...]:
    """What is left without a name: how big, and in which modes."""
    if found.verdict in ("consistent", "explained"):
        return ()
    chosen = found.chosen
    evidence, minimum = chosen.comparison.plates.evidence, chosen.weighed.best
    off = evidence.residual(minimum.predicted)
    worst = off.abs().argsort(descending=True)[: found.settings.n_worst].tolist()
    named = ", ".join(f"mode {int(evidence.mode[k]) + 1} by {float(off[k]):+.1f}" for k in worst)
    rest = max(1.0, evidence.n - minimum.n_effective)
    return (
        f"In standard deviations of the table, the model is off in {named}.",
        f"Scatter alone would have to be {math.sqrt(minimum.chi_square / rest):.1f} times what the table has.",
    )


def all_remarks(found: Found) -> list[str]:
    """On the meshes, the probabilities, the scatter, and what sits where it should not."""
    chosen, posterior, settings = found.chosen, found.posterior, found.settings
    compared, weighed, evidence = chosen.comparison, chosen.weighed, chosen.comparison.plates.evidence
    sentences = list(evidence.sentences)
    if len(found.compared) > 1:
        which = "the mesh as given" if chosen.comparison.kind == "given" else "the mesh with its error taken off"
        gaps = ", ".join(
            f"{percent(one.plates.evidence.gap(one.baseline.best.predicted))} on the {one.kind} one"
            for one in found.compared
        )
        sentences.append(
            f"Both meshes were tried: the fitted given model leaves {gaps}; {which} has the probability "
            f"{posterior.mesh(chosen.comparison.kind):.2g}."
        )
    odds = ", ".join(f"{one:g}" for one in settings.prior_number)
    sentences.append(
        f"Before the table: probability {odds} that no, one, two effects are missing, shared evenly by the effects. "
        f"After it: {posterior.number(0):.2g}, {posterior.number(1):.2g}, {posterior.number(2):.2g}."
    )
    if chosen.names and not found.within_scatter(chosen):
        sentences.append(
            "More than scatter is left, so something is missing that was no hypothesis: these probabilities compare "
            "the effects of the catalogue with one another."
        )
    minimum = weighed.best
    kappa = math.sqrt(evidence.kappa_square(minimum.chi_square))
    sentences.append(f"The scatter that goes with what is left is {kappa:.2g} times the table's.")
    singles = [one for one in compared.weighed if len(one.names) == 1]
    if singles:
        best = min(singles, key=lambda one: one.best.chi_square)
        fall = max(0.0, compared.baseline.best.chi_square - best.best.chi_square)
        sentences.append(
            f"One effect alone takes {fall:.3g} from χ² at most ({best.names[0]}); where nothing is missing, the best "
            f"takes {once_in_a_hundred(compared, settings):.3g} once in a hundred times."
        )
    if compared.n_pair_left:
        sentences.append(
            f"{compared.n_pair_left} pairs of effects that promised less than the others were not refitted."
        )
    values = dict(zip(weighed.model.names, weighed.theta.tolist(), strict=True))
    for name, (mean, std) in found.prior.items():
        if name in values and abs(values[name] - mean) > SETTINGS.comparison.size_limit * std:
            sentences.append(
                f"{name} ends at {values[name]:.4g}, {abs(values[name] - mean) / std:.1f} standard deviations from the "
                f"{mean:.4g} that is known of it: do not believe it; something else is missing."
            )
    sentences += [
        f"{name} sits on the edge of its interval: widen it, or take it as a sign." for name in pressed_out(chosen)
    ]
    return sentences
