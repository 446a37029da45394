"""A test of a plate as its config has it: the model, what was measured, and how well both are known."""

from collections.abc import Callable, Mapping

from torchplate.cli.config.build import Run
from torchplate.cli.schema import Known, quantity
from torchplate.diagnosis import PlateTest


def plate_test(recipe: Run, say: Callable[[str], object] = lambda _: None, name: str = "") -> PlateTest:
    """What a diagnosis takes, or a plan.

    Args:
        recipe: the config.
        say: is told how modes were paired, where shapes were measured.
        name: of the state.

    Raises:
        InputError: if there are both FRFs and natural frequencies, or the model has no such channel or mode.
    """
    recipe.check_memory(finer=2)  # that the mesh error is taken off by
    model = recipe.model_as_given()
    evidence = recipe.checked_evidence(model)
    measurement, table, modal = evidence.measurement, evidence.natural_frequencies, evidence.modal_model
    if measurement is not None and (table or modal) is not None:
        raise recipe.error(
            "measurement", "Expected FRFs or natural frequencies for a diagnosis, got both. Take one of them out."
        )
    if modal is not None:
        table = modal.table(model, say)
    return PlateTest(
        model,
        measurement,
        table,
        tolerances(recipe),
        evidence.n_average,
        evidence.gain_is_unknown,
        recipe.imperfections(),
        name,
    )


def tolerances(recipe: Run) -> dict[str, float]:
    """How well the config's numbers are known: "label.parameter", "mesh.length_x" → standard deviation."""
    sides = {f"mesh.{side}": getattr(recipe.config.mesh, side).std for side in ("length_x", "length_y")}
    found = {key: std for key, std in sides.items() if std > 0}
    for label, body in recipe.config.effects.items():
        for name, value in body.items():
            if isinstance(value, Mapping) and "value" in value:
                number = quantity(value)
                if isinstance(number, Known) and number.std > 0:
                    found[f"{label}.{name}"] = number.std
    return found
