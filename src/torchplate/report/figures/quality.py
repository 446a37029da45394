"""One figure of a measurement as it is: amplitude, phase and coherence of every FRF, its peaks marked."""

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from torchplate.measurement import Measurement, Quality, summed_amplitude
from torchplate.report.figures.style import INK, MUTED, dress

MANY = 6
"""More channels than this are told apart by colour and legend beside the panels, and their phases thinned."""


def quality_figure(measurement: Measurement, quality: Quality, name: str) -> Figure:
    """Amplitude, phase and, where there is any, coherence of every FRF over frequency.

    Args:
        measurement: what was measured.
        quality: what was found in it; its peaks are marked.
        name: of the file, for the title.
    """
    with_coherence = measurement.coherence is not None
    heights = [3.2, 1.5, 1.1] if with_coherence else [3.2, 1.5]
    figure = Figure(figsize=(11, 1.4 + 1.35 * sum(heights)), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    frequency = measurement.frequency.numpy()
    pairs = measurement.pairs
    few = len(pairs) <= MANY
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(pairs)))
    for (j, k), colour in zip(pairs, colours, strict=True):
        values = measurement.frf[:, j, k].numpy()
        decibel = 20 * np.log10(np.where(np.abs(values) > 0, np.abs(values), np.nan))
        label = measurement.pair_label(j, k)
        axes[0].plot(frequency, decibel, color=colour, linewidth=1.1 if few else 0.7, label=label)
        phase = np.degrees(np.angle(values))
        if few:
            # A wrap drawn as a line from +180 to -180 would look like a resonance.
            jump = np.abs(np.diff(phase, prepend=phase[0])) > 180
            axes[1].plot(frequency, np.where(jump, np.nan, phase), color=colour, linewidth=0.9)
        else:
            axes[1].plot(frequency, phase, ".", color=colour, markersize=2.0, alpha=0.8, markeredgewidth=0)
        if measurement.coherence is not None:
            axes[2].plot(frequency, measurement.coherence[:, j, k].numpy(), color=colour, linewidth=0.8)
    axes[0].set_ylabel(f"amplitude [dB re 1 {measurement.unit}]" if measurement.unit != "-" else "amplitude [dB]")
    axes[1].set_ylabel("phase [°]")
    axes[1].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    if with_coherence:
        axes[2].set_ylabel("coherence [-]")
        axes[2].set(ylim=(-0.03, 1.05), yticks=(0, 0.5, 1))
        axes[2].axhline(0.8, color=MUTED, linewidth=0.7, linestyle=(0, (4, 3)))
    for ax in axes:
        dress(ax)
        ax.yaxis.label.set_color(INK)
    _mark_peaks(axes[0], measurement, quality)
    axes[-1].set_xlabel("frequency [Hz]", color=INK)
    axes[-1].set_xlim(*quality.band if len(frequency) > 1 else (None, None))
    _legend(figure, axes[0], len(pairs))
    figure.suptitle(_title(measurement, quality, name), x=0.012, ha="left", fontsize=12, color=INK)
    return figure


def _title(measurement: Measurement, quality: Quality, name: str) -> str:
    n = len(measurement.pairs)
    step = "uneven step" if quality.step is None else f"step {quality.step:g} Hz"
    return (
        f"{name}: {measurement.kind}, {n} FRF{'s' if n > 1 else ''}, "
        f"{quality.band[0]:g} to {quality.band[1]:g} Hz, {step}"
    )


def _mark_peaks(ax: Axes, measurement: Measurement, quality: Quality) -> None:
    if not quality.peaks:
        return
    low, high = ax.get_ylim()
    span = quality.band[1] - quality.band[0]
    # Upright labels stand in a strip above the curves; each takes about 1.3 % of the width, so that of
    # close peaks only the highest is named.
    ax.set_ylim(low, high + 0.16 * (high - low))
    text_level = high + 0.03 * (high - low)
    height = dict(zip(measurement.frequency.tolist(), summed_amplitude(measurement).tolist(), strict=True))
    named: list[float] = []
    for peak in sorted(quality.peaks, key=lambda f: -height[f]):
        ax.axvline(peak, color=MUTED, linewidth=0.6, linestyle=(0, (2, 3)), zorder=0.5)
        if all(abs(peak - other) >= 0.013 * span for other in named):
            ax.text(peak, text_level, f"{peak:.5g}", rotation=90, fontsize=7.5, color=INK, ha="center", va="bottom",
                    bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8})  # fmt: skip
            named.append(peak)
    ax.set_ylim(low, ax.get_ylim()[1])


def _legend(figure: Figure, ax: Axes, n: int) -> None:
    if n == 1 or n > 60:
        if n > 60:
            ax.annotate(f"{n} FRFs, coloured in the order of the report", (1, 1), xycoords="axes fraction", ha="right",
                        va="bottom", fontsize=8, color=MUTED)  # fmt: skip
        return
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", ncols=1 if n <= 30 else 2, fontsize=8, frameon=False,
                  title="response/reference", title_fontsize=8, handlelength=1.4, labelcolor=INK)  # fmt: skip
