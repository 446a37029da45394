"""Whether a field without a name has the right kind and place, of what lies beyond the catalogue.

| hidden | kind | place |
|---|---|---|
| hinge | stiffness | x of the line |
| cubic_spring | support | x and y |
| residual_stress, curvature, frequency_dependent_modulus | stiffness | none: all over the plate |
| clipped_channel | no field: it is not in the plate | none |
"""

from typing import Any

KINDS = {
    "hinge": "stiffness",
    "cubic_spring": "support",
    "residual_stress": "stiffness",
    "curvature": "stiffness",
    "frequency_dependent_modulus": "stiffness",
    "clipped_channel": None,
}
# Of the side.
NEAR = 0.1
MISSING = ("unexplained", "partly_explained")


def field_of(record: dict[str, Any]) -> tuple[bool, float | None] | None:
    """Whether the kind is right, and how far off the place is, of the side; None where no field was to be found.

    The place is None where there is none to be right about; without a field it is as far off as can be. Of places that
    are said to be alike the nearest counts.
    """
    truth, diagnosis = record["truth"], record.get("diagnosis")
    if truth["kind"] != "beyond" or not diagnosis or diagnosis["verdict"] not in MISSING:
        return None
    name, true, found = truth["hidden"][0]["effect"], truth["extra"], diagnosis.get("field")
    right = (found["kind"] if found else None) == KINDS[name]
    axes = [axis for axis in ("x", "y") if axis in true]
    if not axes:
        return right, None
    if not found:
        return right, 1.0
    places = [found["place"], *found["others"]]
    return right, min(max(abs(place[axis] - true[axis]) for axis in axes) for place in places)
