"""What a config says of a measurement, or of several states of one plate."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import field_validator

from torchplate.cli.schema.key import Strict, key
from torchplate.cli.schema.numbers import Known


class FrameConfig(Strict):
    """Where the plate lies in the coordinates of the file."""

    unit: Literal["m", "cm", "mm", "in"] = key("of the coordinates and of `origin`", example="mm", default="m")
    origin: tuple[float, float, float] = key(
        "the plate's corner (0, 0)", "`unit`", example=[-240.0, -240.0, 0.0], default=(0.0, 0.0, 0.0)
    )
    x_axis: tuple[float, float, float] = key(
        "direction of the side x, of any length", example=[0.0, 1.0, 0.0], default=(1.0, 0.0, 0.0)
    )
    y_axis: tuple[float, float, float] = key(
        "direction of the side y, at a right angle to it", example=[-1.0, 0.0, 0.0], default=(0.0, 1.0, 0.0)
    )


class ModalModelConfig(Strict):
    """Natural frequencies with their mode shapes. Its points are placed by `nodes` and `frame`, as channels are."""

    file: Path = key(
        ".uff or .unv (datasets 55 or 2414), or a table .csv; counts from the config's folder", example="modes.uff"
    )
    frequency_std: float | None = key(
        "standard deviation of the frequencies, relative; 0.001 where nothing is said",
        example=0.002,
        default=None,
        gt=0,
    )
    shape_std: float | None = key(
        "standard deviation of the shapes, √(1 − MAC); 0.1 where nothing is said, a MAC of 0.99",
        example=0.05,
        default=None,
        gt=0,
    )


class MeasurementConfig(Strict):
    """What was measured, and where. `response` and `reference` stand in where no file names them."""

    file: Path | None = key(
        ".uff or .unv (datasets 58, 15 or 2411) or .npz; counts from the config's folder",
        example="plate.uff",
        default=None,
    )
    nodes: Path | None = key("a table node, x, y[, z] for files without coordinates", example="nodes.csv", default=None)
    frame: FrameConfig | None = key(
        "where the plate lies in the file's coordinates; see below", example={"unit": "mm"}, default=None
    )
    band: tuple[float, float] | None = key("lines that count", "Hz", example=[5.0, 400.0], default=None)
    kind: Literal["receptance", "mobility", "accelerance", "transmissibility"] | None = key(
        "of the FRFs, where the file does not say; transmissibility is response over the motion of the held edges",
        example="accelerance",
        default=None,
    )
    gain: Literal["known", "unknown"] = key(
        "`unknown` fits a factor on all levels, where they carry no unit", example="unknown", default="known"
    )
    n_average: int | None = key(
        "records behind the coherence; makes it a standard error of each line", example=5, default=None, ge=2
    )
    natural_frequencies: dict[int, Known] | None = key(
        "mode number, counted from 1 with the rigid-body modes: frequency; alone or beside a file",
        "Hz",
        example={4: 68.4, 5: {"value": 97.1, "std": 0.1}},
        default=None,
    )
    modal_model: ModalModelConfig | None = key(
        "frequencies and mode shapes, paired with the model's by MAC; alone or beside a file; see below",
        example={"file": "modes.uff"},
        default=None,
    )
    response: list[int | tuple[float, float]] | None = key(
        "nodes or relative places of the sensors", "node or [-, -]", example=[3, [0.6, 0.7]], default=None
    )
    reference: list[int | tuple[float, float]] | None = key(
        "nodes or relative places of the forces", "node or [-, -]", example=[28, 102], default=None
    )
    position_std: float | None = key(
        "standard deviation of hits and sensors from their marks; 0.001 where nothing is said",
        "m",
        example=0.002,
        default=None,
        ge=0,
    )
    frequency_drift: float | None = key(
        "of all natural frequencies from record to record, relative; 1e-4 where nothing is said",
        example=2.0e-4,
        default=None,
        ge=0,
    )
    calibration_std: float | None = key(
        "of the level of each channel, relative; 0.01 where nothing is said", example=0.02, default=None, ge=0
    )
    damping_scatter: float | None = key(
        "of each mode's damping about its law, relative; 0.1 where nothing is said",
        example=0.15,
        default=None,
        ge=0,
    )
    thickness_scatter: float | None = key(
        "of the plate's thickness from place to place, relative, for `diagnose` of FRFs; 0.005 where nothing is said; "
        "`simulate` takes the effect `thickness_field`",
        example=0.02,
        default=None,
        ge=0,
    )

    @field_validator("natural_frequencies", mode="before")
    @classmethod
    def _plain_numbers(cls, value: Any) -> Any:
        """A number stands for {value: number}."""
        if not isinstance(value, Mapping):
            return value
        return {mode: entry if isinstance(entry, Mapping) else {"value": entry} for mode, entry in value.items()}


class StateConfig(MeasurementConfig):
    """One of several states of a plate: `measurement` is then a list. It has the keys of a single one, and these."""

    name: str = key(
        "of the state; its own parameters are label.parameter@name", example="after", pattern=r"^[A-Za-z0-9_-]+$"
    )
    own: list[str] = key(
        "searched parameters label.parameter that have a value of their own in this state; all others are common",
        example=["wires.stiffness"],
        default=[],
    )
    effects: dict[str, dict[str, Any]] = key(
        "label: effects of this state alone, beside the common ones or in their place; their parameters are its own",
        example={"magnet": {"effect": "point_mass", "x": 0.3, "y": 0.7, "mass": 0.024}},
        default={},
    )


# What a state has beside the keys of a single measurement.
STATE_KEYS: Final = ("name", "own", "effects")
