"""Where a model and a measurement disagree: in frequency, over the channels, over the plate, and of which kind."""

import torch
from jaxtyping import Complex, Float
from torch import Tensor

from torchplate.diagnosis.localisation.factor import common_factor, own_factor
from torchplate.diagnosis.localisation.force import Force, force_at
from torchplate.diagnosis.localisation.misfit import Misfit
from torchplate.diagnosis.localisation.sentences import of_bands, of_channels, of_kind
from torchplate.diagnosis.result import ChannelGap, Location
from torchplate.diagnosis.settings import SETTINGS
from torchplate.measurement import Measurement
from torchplate.model import PlateModel


@torch.no_grad()
def localise(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    predicted: Complex[Tensor, "n_frequency n_response n_reference"],
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
    channels: tuple[ChannelGap, ...],
) -> Location:
    """Tell where the misfit sits.

    Args:
        measurement: what was measured.
        noise_std: standard deviation of the real and of the imaginary part, in its unit.
        predicted: the fitted baseline's FRFs.
        model: it; its own responses and references are those of the measurement.
        theta: its parameters [SI].
        channels: the gap of each FRF, the worst first.
    """
    misfit = Misfit.of(measurement, noise_std, predicted)
    if misfit.excess <= (SETTINGS.localising.beyond_noise - 1) * misfit.noise:
        return Location(
            (),
            channels,
            {},
            None,
            ("No band, channel or place stands out of what the model leaves, beside what it was judged by.",),
        )
    bands = misfit.bands(measurement.frequency)
    chain = common_factor(misfit, measurement.frequency)
    one = own_factor(misfit, measurement)
    kind = {"sensor chain": chain.part, "single channel": one.part}
    sentences = [of_bands(bands), of_channels(channels)]
    field, force = None, None
    field_force = force_at(misfit, measurement, model, theta)
    if field_force is not None:
        field, force = field_force
        kind = {"force": force.free, **force.parts, **kind}
    sentences += of_kind(force, chain, one)
    return Location(bands, channels, kind, field, tuple(sentence for sentence in sentences if sentence))


@torch.no_grad()
def missing_force(
    measurement: Measurement,
    noise_std: Float[Tensor, "n_frequency n_response n_reference"],
    predicted: Complex[Tensor, "n_frequency n_response n_reference"],
    model: PlateModel,
    theta: Float[Tensor, " n_parameter"],
) -> "Force | None":
    """The force at one place that explains most of the misfit; None where there is none, or too few FRFs to say.

    Args:
        measurement: what was measured.
        noise_std: standard deviation of the real and of the imaginary part, in its unit.
        predicted: the model's FRFs.
        model: it; its own responses and references are those of the measurement.
        theta: its parameters [SI].
    """
    misfit = Misfit.of(measurement, noise_std, predicted)
    if misfit.excess <= (SETTINGS.localising.beyond_noise - 1) * misfit.noise:
        return None
    found = force_at(misfit, measurement, model, theta)
    return None if found is None else found[1]
