"""A config and the measurement that it names, read and placed on the plate."""

import dataclasses
import functools
import math
import os

from torchplate.cli.config.recipe import Recipe
from torchplate.cli.schema import FrameConfig
from torchplate.measurement import (
    FRF_SUFFIX,
    Channel,
    Frame,
    Imperfections,
    Measurement,
    ModalModel,
    Placement,
    in_frame,
    place,
    read_measurement,
    read_modal_model,
    read_node_table,
    with_node_table,
)
from torchplate.nearest import nearest

MISSED = 0.1
"""Part of the longer side that nobody's hits are off their marks by."""
FEW, BEYOND = 10, 1.5
"""Lines below which a band has few, and its end over the file's last line from where it is not of this file."""


@dataclasses.dataclass(frozen=True)
class Measured(Recipe):
    """A checked config with what was measured; see `Recipe`."""

    @property
    def has_file(self) -> bool:
        """Whether the measurement's file is there."""
        file = self.config.measurement.file
        return file is not None and (self.path.parent / file).exists()

    def measurement(self) -> Measurement | None:
        """The FRFs of the measurement file, cut to the band, without dead ones; None where the config names no file."""
        return self._frfs

    @functools.cached_property
    def _frfs(self) -> Measurement | None:
        band, whole = self.config.measurement.band, self._whole
        if whole is None:
            return None
        frfs = whole if band is None else self.told("measurement.band", lambda: whole.band(*band))
        return self.told("measurement.file", frfs.without_zeros)

    @functools.cached_property
    def _whole(self) -> Measurement | None:
        """The same with all lines of the file."""
        settings = self.config.measurement
        if settings.file is None:
            return None
        path = self.path.parent / settings.file
        if not path.exists():
            here = (
                f" {settings.file} is there, but paths count from the config's folder:"
                if settings.file.exists()
                else ""
            )
            special = any(letter < " " for letter in str(settings.file))
            shown = repr(str(path))[1:-1] if special else path
            near = os.path.relpath(settings.file, self.path.parent)
            like = nearest(path.name, [one.name for one in path.parent.glob("*") if one.suffix.lower() in FRF_SUFFIX])
            guess = f" Did you mean {settings.file.parent / like}?" if like else ""
            if path.parts[len(self.path.parent.parts) :][:1] == ("~",):
                guess = " ~ is not followed here: write the whole path."
            elif special:
                guess = " In double quotes YAML takes \\ for the beginning of a special character: write / instead."
            action = (
                f"{here} write {near}." if here else f"{guess} Correct the path, which counts from the config's folder."
            )
            raise self.error("measurement.file", f"Expected a file, found none at {shown}.{action}")
        if path.is_dir():
            raise self.error(
                "measurement.file", f"Expected a file, got the folder '{path}'. Name a .uff or .npz file in it."
            )
        frame = self.told("measurement.frame", lambda: Frame(**(settings.frame or FrameConfig()).model_dump()))
        frfs = self.told("measurement.file", lambda: read_measurement(path, settings.kind, frame.normal))
        if settings.nodes is not None:
            table = self.path.parent / settings.nodes
            frfs = self.told("measurement.nodes", lambda: with_node_table(frfs, read_node_table(table), frame.unit))
        if settings.frame is not None:
            frfs = in_frame(frfs, frame)
        return frfs

    def band_remarks(self) -> tuple[str, ...]:
        """What the band looks like, where it holds few lines of the file or ends far beyond it."""
        band, whole, frfs = self.config.measurement.band, self._whole, self.measurement()
        if band is None or whole is None or frfs is None:
            return ()
        first, last = float(whole.frequency[0]), float(whole.frequency[-1])
        span, given = f"the file's {first:g} to {last:g} Hz", f"measurement.band: {band[0]:g} to {band[1]:g} Hz"
        n_line = len(frfs.frequency)
        if n_line < FEW:
            wide = [1e3 * end for end in band]
            hint = f" If it is in kHz, write {_pair(*wide)}." if first <= wide[0] and wide[1] <= 1.05 * last else ""
            lines = f"{n_line} line{'s' if n_line > 1 else ''}"
            return (f"{given} holds {lines} of {span}, too few to see a resonance.{hint or ' Widen it.'}",)
        if band[1] > BEYOND * last:
            slow = [end / (2 * math.pi) for end in band]
            hint = f" If it is in rad/s, write {_pair(*slow)}." if slow[1] <= 1.05 * last else ""
            return (f"{given} ends beyond {span}, whose last line counts as its end.{hint}",)
        return ()

    def spread_remarks(self) -> tuple[str, ...]:
        """What hits and sensors are said to be off their marks by, where it is more than anybody misses."""
        std, mesh = self.config.measurement.position_std, self.config.mesh
        longer = max(mesh.length_x.value, mesh.length_y.value)
        if std is None or std <= MISSED * longer:
            return ()
        return (
            f"measurement.position_std: {std:g} m is more than a tenth of the longer side, {longer:g} m. If it is in "
            f"mm, write {1e-3 * std:g}.",
        )

    def placement(self, frfs: Measurement) -> Placement:
        """Where the measurement's responses and references sit on the plate."""
        settings = self.config.mesh
        sides = settings.length_x.value, settings.length_y.value
        return self.told("measurement.file", lambda: place(frfs, *sides, settings.n_x, settings.n_y))

    @functools.cached_property
    def modal_model(self) -> ModalModel | None:
        """The modes of the modal model's file within the band, its points on the plate; None where there is none."""
        settings = self.config.measurement
        if settings.modal_model is None:
            return None
        path = self.path.parent / settings.modal_model.file
        frame = self.told("measurement.frame", lambda: Frame(**(settings.frame or FrameConfig()).model_dump()))
        found = self.told("measurement.modal_model", lambda: read_modal_model(path, frame.normal))
        if settings.nodes is not None:
            table = self.path.parent / settings.nodes
            nodes = self.told("measurement.nodes", lambda: read_node_table(table).scaled(frame.unit))
            if missing := sorted({one.node for one in found.point} - set(nodes)):
                raise self.error(
                    "measurement.nodes",
                    f"Expected every point of the mode shapes, got none of {missing[:6]}. Add them.",
                )
            found = found.with_points(lambda one: dataclasses.replace(one, coordinate=nodes[one.node]))
        if settings.frame is not None:
            found = found.with_points(lambda one: _moved(one, frame))
        if settings.band is not None:
            band = settings.band
            found = self.told("measurement.band", lambda: found.band(*band))
        return found

    def imperfections(self) -> Imperfections:
        """What the test is not perfect in, as far as the config tells."""
        settings = self.config.measurement
        return Imperfections(
            **{field.name: getattr(settings, field.name) for field in dataclasses.fields(Imperfections)}
        )


def _moved(channel: Channel, frame: Frame) -> Channel:
    """A channel with its coordinates in the plate's own axes."""
    if channel.coordinate is None:
        return channel
    return dataclasses.replace(channel, coordinate=frame.on_plate(channel.coordinate))


def _pair(low: float, high: float) -> str:
    return f"[{low:.3g}, {high:.3g}]"
