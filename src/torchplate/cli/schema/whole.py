"""A config, whole: the plate, its effects, what was measured, the objective, the search, and what is drawn."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import ConfigDict, field_validator

from torchplate.cli.schema.key import Numbers, Strict, key
from torchplate.cli.schema.measured import STATE_KEYS, MeasurementConfig
from torchplate.cli.schema.numbers import Known, Unknown
from torchplate.cli.schema.quantity import quantity


class MeshConfig(Strict):
    """The plate and its elements."""

    length_x: Known = key("side along x; the sides are not searched", "m", example=0.48)
    length_y: Known = key("side along y", "m", example={"value": 0.48, "std": 0.0005})
    n_x: int = key("elements along x, which also number the nodes", example=10, gt=0)
    n_y: int = key("elements along y", example=10, gt=0)
    refine: int = key("splits each element in refine × refine; no label changes", example=2, default=1, gt=0)
    edges: dict[str, Literal["free", "simply_supported", "clamped"]] = key(
        "how the edges x0, x1, y0, y1 are held; those left out are free", example={"x0": "clamped"}, default={}
    )
    extrapolate: bool = key(
        "takes the error of the mesh off natural frequencies and mode shapes, from a mesh twice as fine",
        example=True,
        default=False,
    )
    cut: list[tuple[float, float, float, float]] = key(
        "holes and missing corners [x0, y0, x1, y1], on lines of the mesh: their elements are left out",
        "relative to the plate",
        example=[[0.3, 0.4, 0.5, 0.6]],
        default=[],
    )

    @field_validator("length_x", "length_y", mode="before")
    @classmethod
    def _length(cls, value: Any) -> Any:
        found = quantity(value)
        if isinstance(found, Unknown):
            raise ValueError("a number in m, since the sides of the plate are not searched (an effect may change them)")
        return found


class ObjectiveConfig(Strict):
    """How the gap between model and measurement is measured."""

    kind: str = key("the measure; see below", example="log_amplitude", default="relative_frf_norm")
    natural_frequency_weight: float = key(
        "scales the part of natural frequencies beside FRFs", example=2.0, default=1.0, gt=0
    )


class SearchConfig(Numbers):
    """The optimiser and when it stops. Its own settings stand beside these keys; see below."""

    model_config = ConfigDict(extra="allow", frozen=True)

    optimizer: str = key("the search; see below", example="artificial_bee_colony", default="differential_evolution")
    n_generation: int = key("generations at most", example=200, default=100, gt=0)
    n_evaluation: int | None = key("evaluations at most", example=3200, default=None, gt=0)
    tolerance: float | None = key(
        "stops when the members' objectives scatter by no more than this times their mean",
        example=1.0e-6,
        default=1e-8,
        ge=0,
        allow_inf_nan=False,
    )
    stagnation: int | None = key(
        "stops after this many generations without improvement", example=30, default=None, gt=0
    )
    target: float | None = key("stops at this objective", example=0.1, default=None)
    seed: int = key("of the random numbers", example=3, default=0, ge=0, lt=2**63)
    n_repeat: int = key("independent searches, run at once; the best is the result", example=20, default=1, gt=0)
    polish: bool = key("finishes with least squares and keeps what is lower", example=True, default=False)
    basis: Literal["auto", "full"] = key(
        "`full` insists on all dofs instead of a reduced basis whose error is checked", example="full", default="auto"
    )
    precision: Literal["double", "single"] = key(
        "of the FRFs within the search; what was found is evaluated in double", example="single", default="double"
    )


class LogConfig(Strict):
    """How much is drawn."""

    n_figure: int = key("times that FRFs are drawn to TensorBoard during a search", example=10, default=4, ge=0)
    n_panel: int = key("FRFs that each of these, and the report, shows", example=12, default=6, gt=0)


class ModalTestConfig(Strict):
    """The virtual test that `simulate` makes."""

    analyser: str | dict[str, Any] = key(
        "a named analyser, or its settings; see below", example={"like": "sr785", "n_average": 10}, default="sr785"
    )
    hammer: dict[str, Any] = key("settings of the hammer; see below", example={"peak_force": 20.0}, default={})
    response: list[int | tuple[float, float]] | None = key(
        "sensors; those of `measurement`, else node 3", "node or [-, -]", example=[3], default=None
    )
    reference: list[int | tuple[float, float]] | None = key(
        "points that are hit; those of `measurement`, else every node",
        "node or [-, -]",
        example=[28, 102, 104],
        default=None,
    )
    kind: Literal["receptance", "mobility", "accelerance"] = key(
        "of the FRFs that are written", example="mobility", default="accelerance"
    )
    refine: int = key("splits the config's elements, so that the test has its own mesh", example=2, default=3, gt=0)
    extrapolate: bool = key("takes the error of that mesh off", example=False, default=True)
    seed: int = key("of the hits and the noise", example=1, default=0, ge=0, lt=2**63)


class Config(Strict):
    """One run, whole."""

    mesh: MeshConfig = key(
        "the plate and its elements", example={"length_x": 0.48, "length_y": 0.48, "n_x": 10, "n_y": 10}
    )
    effects: dict[str, dict[str, Any]] = key(
        "label: what the model is made of, by the catalogue of effects",
        example={"magnet": {"effect": "point_mass", "x": 0.27, "y": 0.68, "mass": 0.024}},
    )
    measurement: MeasurementConfig = key(
        "what was measured", example={"file": "plate.uff"}, default=MeasurementConfig()
    )
    objective: ObjectiveConfig = key(
        "how the gap is measured", example={"kind": "log_amplitude"}, default=ObjectiveConfig()
    )
    search: SearchConfig = key("how it is made small", example={"n_member": 16}, default=SearchConfig())
    modal_test: ModalTestConfig = key(
        "the virtual test of `simulate`", example={"kind": "mobility"}, default=ModalTestConfig()
    )
    log: LogConfig = key("how much is drawn", example={"n_panel": 12}, default=LogConfig())

    @field_validator("measurement", mode="before")
    @classmethod
    def _first_state(cls, value: Any) -> Any:
        """Of several states the first; `validated_states` looks at all of them."""
        if not isinstance(value, list) or not value or not isinstance(value[0], Mapping):
            return value
        return {name: inner for name, inner in value[0].items() if name not in STATE_KEYS}
