"""An effect of a table that is named, with its confidence and its evidence in words; and the mesh as one."""

from collections.abc import Sequence

from torchplate.diagnosis.result import Estimate, Named, Step
from torchplate.diagnosis.table.found import Found, compared_on, key_of, pressed_out, same_on
from torchplate.notation import percent


def finer_mesh(found: Found) -> tuple[Named, ...]:
    """The mesh as a missing effect of its own, where the corrected one is likelier and closes a gap."""
    given, corrected, chosen = compared_on(found, "given"), compared_on(found, "corrected"), found.chosen
    if given is None or corrected is None or chosen.comparison is not corrected:
        return ()
    probability = found.posterior.mesh("corrected")
    coarse = same_on(given, key_of(chosen)) or given.baseline
    before, after = (
        one.plates.evidence.gap(weighed.best.predicted)
        for one, weighed in ((given, coarse), (corrected, chosen.weighed))
    )
    if probability < found.settings.set_probability or after >= before:
        return ()
    cells = " × ".join(str(cell) for cell in given.plates.model.mesh.cells)
    fine = " × ".join(str(cell) for cell in corrected.plates.model.mesh.cells)
    text = (
        f"On {cells} elements the gap is {percent(before)}; on {fine}, with the error of the natural frequencies "
        f"extrapolated, it is {percent(after)}."
    )
    refine = corrected.plates.model.mesh.refine // given.plates.model.mesh.refine
    options = {"refine": refine, "extrapolate": True}
    return (
        Named(
            "mesh_discretisation", "mesh_discretisation", options, (), round(probability, 3), {}, text, before, after
        ),
    )


def as_named(found: Found, index: int, numbers: dict[str, Estimate], steps: Sequence[Step]) -> Named:
    """An effect as it is reported."""
    chosen, posterior = found.chosen, found.posterior
    hypothesis = chosen.weighed.hypothesis
    assert hypothesis is not None
    part, label = hypothesis.parts[index], hypothesis.labels[index]
    parameters = {name.removeprefix(f"{label}."): one for name, one in numbers.items() if name.startswith(f"{label}.")}
    equivalent = posterior.equivalent(chosen, part.name)
    confidence = posterior.has([part.name, *equivalent])
    pressed = any(name.startswith(f"{label}.") for name in pressed_out(chosen))
    if not found.within_scatter(chosen) or (pressed and not equivalent):
        confidence = min(confidence, found.settings.most_doubtful)
    after = [step for step in steps if step.label != "+ mesh_discretisation"]
    before, left = after[index].gap, after[index + 1].gap
    if steps[0] is after[0] and index == 0 and len(after) != len(steps):
        before = steps[1].gap
    values = [f"{name} {one.value:.4g}{'' if one.unit == '-' else ' ' + one.unit}" for name, one in parameters.items()]
    values += [f"{name} {value}" for name, value in part.candidate.options.items()]
    rivals = [one for one in posterior.rivals(chosen, part.name) if one[0] not in equivalent]
    own = max(rivals[0][1], 1e-300)
    against = ""
    if len(rivals) > 1:
        against = f"; the next best in its place, {rivals[1][0]}, is {_odds(own, rivals[1][1])} less probable"
    alike = f"; this table cannot tell it from {' or '.join(equivalent)}" if equivalent else ""
    text = f"{part.name} ({', '.join(values) or 'no number'}) takes the gap from {percent(before)} to {percent(left)}"
    return Named(
        part.name,
        label,
        part.candidate.options,
        equivalent,
        round(confidence, 3),
        parameters,
        f"{text}{against}{alike}.",
        before,
        left,
    )


def _odds(own: float, other: float) -> str:
    ratio = own / max(other, 1e-300)
    return f"{ratio:.3g} times" if ratio < 1e4 else "more than 10,000 times"
