"""The commented YAML that `torchplate new` writes."""

import shlex
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from torchplate.measurement import Said
from torchplate.plate import ELEMENTS_PER_WAVELENGTH

WIDE = 2.5
"""Factor up and down in which the grain is searched about what the resonances say [-]; what was tried is 1.4 apart."""

if TYPE_CHECKING:
    from torchplate.cli.verbs.new_draft import Draft


def compose(draft: "Draft", file: str, nodes: str | None) -> str:
    """The config as text.

    Args:
        draft: What goes in.
        file: The measurement, as seen from the config.
        nodes: The table of nodes, likewise, if there is one.
    """
    lines = [
        f"# Written by `torchplate new {shlex.quote(draft.file.name)}`. A number is taken as known, an interval is "
        "searched, and",
        "# {value: , std: } is known so well. Correct what is marked as a guess before you trust a result.",
        *_mesh(draft),
        *_measurement(draft, file, nodes),
        *_effects(draft),
        *_search(draft),
    ]
    return "\n".join(lines) + "\n"


def _said(said: Said) -> str:
    return f"# guess: {said.text}" if said.guess else f"# {said.text}"


def _mesh(draft: "Draft") -> list[str]:
    proposal = draft.proposal
    edges = "".join(f"{edge}: {condition}, " for edge, condition in draft.edges.items())[:-2]
    return [
        "mesh:",
        f"  {_said(proposal.sides)}",
        *(f"  # {line}" for line in textwrap.wrap(draft.heard.sides, 110)),
        f"  length_x: {_number(proposal.length_x, 0.001)}    # m",
        f"  length_y: {_number(proposal.length_y, 0.001)}    # m",
        f"  # {draft.per_wave:.1f} elements along the shortest bending wave at {draft.band[1]:g} Hz; "
        f"{ELEMENTS_PER_WAVELENGTH:g} leave 0.4 % of mesh error in the",
        "  # highest natural frequency, and less below. `mesh.refine: 2` quarters it; `diagnose` takes it off.",
        f"  n_x: {draft.cells[0]}",
        f"  n_y: {draft.cells[1]}",
        *([f"  edges: {{{edges}}}"] if edges else []),
    ]


def _measurement(draft: "Draft", file: str, nodes: str | None) -> list[str]:
    proposal, frame = draft.proposal, draft.proposal.frame
    lines = ["measurement:", f"  file: {_quoted(file)}"]
    if nodes is not None:
        lines.append(f"  nodes: {_quoted(nodes)}")
    lines += [
        f"  frame:                          # where the plate lies in the {'table' if nodes else 'file'}'s coordinates",
        f"    unit: {frame.unit}    {_said(proposal.unit)}",
        f"    {_said(proposal.origin)}",
        f"    origin: {_vector(frame.origin)}",
        f"    {_said(proposal.axes)}",
        f"    x_axis: {_vector(frame.x_axis)}",
        f"    y_axis: {_vector(frame.y_axis)}",
        f"  # from: {draft.band_reasons[0]};",
        f"  # to: {draft.band_reasons[1]}",
        f"  band: [{draft.band[0]:g}, {draft.band[1]:g}]    # Hz",
        f"  kind: {draft.measurement.kind}",
    ]
    if draft.measurement.kind != "transmissibility":
        lines += [f"  {line}" for line in _gain(draft)]
    if draft.measurement.coherence is not None:
        lines.append("  # n_average: 5                  # hits at each point: with it the coherence tells the noise")
    lines.append("  # position_std: 0.001           # m, how far hits and sensors may be off their marks")
    lines.append("  # thickness_scatter: 0.005      # how far the thickness wanders over the plate, by a calliper")
    return lines


def _gain(draft: "Draft") -> list[str]:
    if draft.gain_is_known:
        return [f"gain: known    # the level is {draft.level:.2g} times that of such a plate, so its unit is believed"]
    if draft.level is None:
        reason = "nothing to hold the level against"
    elif draft.wishes.thickness is None or draft.wishes.material is None:
        reason = "thickness or material are not known, so the level cannot be checked"
    else:
        reason = f"the level is {draft.level:.2g} times that of such a plate, so its unit is not believed"
    return [f"# guess: {reason}", "gain: unknown    # write known where the unit is sure"]


def _effects(draft: "Draft") -> list[str]:
    material, wishes = draft.material, draft.wishes
    low, _, high = material.youngs_modulus
    what = f"{material.name} ({material.source})"
    if wishes.material is None:
        said = textwrap.wrap(f"guess: no material was named; {draft.heard.said}".rstrip("; "), 110)
        what = "\n    # ".join(said)
    if draft.orthotropic:
        what += "; E is √(E_x E_y)"
    modulus = f"{{low: {_si(low)}, high: {_si(high)}, scale: log}}" if high > 2 * low else f"[{_si(low)}, {_si(high)}]"
    if wishes.mass is not None and wishes.thickness is not None:
        density = f"{draft.density:g}    # kg/m³, the plate's mass over its volume"
    elif wishes.material:
        spread = (material.density[2] - material.density[0]) / 4
        density = f"{{value: {draft.density:g}, std: {spread:.2g}}}    # kg/m³, as usual; better: --mass"
    else:
        density = f"{draft.density:g}    # kg/m³, guess: only h√(E/ρ) can be found"
    if wishes.thickness is None:
        thickness = f"{{low: {draft.thickness[0]:g}, high: {draft.thickness[2]:g}, scale: log}}"
        thickness += f"    # m, guess by {draft.heard.by}: measure it"
        # A level of h and one of E do the same to every natural frequency.
        modulus = _si(material.youngs_modulus[1])
    else:
        thickness = f"{_number(wishes.thickness, 0.01)}    # m"
    lines = [
        "effects:",
        "  plate:",
        "    effect: plate",
        f"    # {what}",
        f"    youngs_modulus: {modulus}    # Pa",
        f"    poisson_ratio: {{value: {material.poisson_ratio:g}, std: {material.poisson_std:g}}}",
        f"    density: {density}",
        f"    thickness: {thickness}",
    ]
    if draft.orthotropic:
        heard = draft.heard
        along = heard.young_ratio < 1
        ratio, shear = ((0.02, 1.0) if along else (1.0, 50.0)), (0.4, 2.5)
        if heard.shear_factor is not None:
            ratio = heard.young_ratio / WIDE, heard.young_ratio * WIDE
            shear = heard.shear_factor / WIDE, heard.shear_factor * WIDE
        why = "the longer side" if heard.shear_factor is None else "as the resonances say"
        lines += [
            "  grain:                          # wood is stiffer along the grain",
            "    effect: orthotropy",
            f"    # guess: the grain runs along {'x' if along else 'y'}, {why}; E_y/E_x",
            f"    young_ratio: {{low: {ratio[0]:.3g}, high: {ratio[1]:.3g}, scale: log}}",
            f"    shear_factor: {{low: {shear[0]:.3g}, high: {shear[1]:.3g}, scale: log}}",
        ]
    low, high = material.loss_factor
    lines += [
        "  loss:",
        "    effect: hysteretic_damping",
        f"    stiffness_loss_factor: {{low: {_si(low)}, high: {_si(high)}, scale: log}}",
        *_supports(draft),
        *_window(draft),
        "  # air: {effect: air_loading, density: 1.2}    # kg/m³: what was measured in a room drags the air along",
    ]
    return lines


def _window(draft: "Draft") -> list[str]:
    rate = draft.measurement.window
    if not rate:
        return []
    return [f"  window: {{effect: exponential_window, rate: {rate:.6g}}}    # 1/s, as the file says: it is taken off"]


def _supports(draft: "Draft") -> list[str]:
    if draft.supports is None:
        if draft.edges:
            return []
        head = ["  # guess: free, as nobody told (--supports). Where it hangs or stands on springs, by their places:"]
        return head + [f"  # {line}" for line in _springs(((0.1, 0.0), (0.9, 0.0)))]
    if not draft.supports:
        return []
    head = ["  # guess: four springs near the corners"] if draft.wishes.supports == ("springs",) else []
    return head + [f"  {line}" for line in _springs(draft.supports)]


def _springs(places: Sequence[tuple[float, float]]) -> list[str]:
    at = ", ".join(f"[{x:.6g}, {y:.6g}]" for x, y in places)
    return [
        "supports:",
        "  effect: support_spring",
        f"  at: [{at}]    # x and y over the sides",
        "  stiffness: {low: 1.0e+1, high: 1.0e+6, scale: log}    # N/m",
        "  viscous_damping: {low: 1.0e-3, high: 1.0e+2, scale: log}    # N s/m",
    ]


def _search(draft: "Draft") -> list[str]:
    # No basis serves plates of many grains, so that each member takes an eigenproblem of its own.
    few = draft.heard.shear_factor is not None
    n_member, n_generation = (16, 50) if few else (32, 100)
    return [
        "# Amplitudes in decibel find the way from a far start; `relative_frf_norm`, the default, weighs the peaks.",
        "objective: {kind: log_amplitude}",
        f"search: {{optimizer: differential_evolution, strategy: rand/1/bin, n_member: {n_member}, "
        "differential_weight: 0.7,",
        f"  crossover_rate: 0.9, n_generation: {n_generation}, {'polish: true, ' if few else ''}seed: 0}}",
    ]


def _number(value: float, relative: float) -> str:
    """A length as a calliper or a ruler knows it."""
    return f"{{value: {value:g}, std: {relative * value:.1g}}}"


def _si(value: float) -> str:
    return f"{value:.4g}" if 1e-3 <= abs(value) < 1e6 else f"{value:.3e}"


def _vector(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{value:.9g}" for value in values) + "]"


def _quoted(path: str) -> str:
    return '"' + path.replace("\\", "/").replace('"', '\\"') + '"'
