"""Where nothing of the catalogue accounts for what is left: what is missing as a field over the plate, without a name.

A force at one place comes first, which the catalogue may have a name for once its place is known; where it leaves more
than noise, a field.

- `infer`: the steps, from a fitted model to a field and how probable each kind of it is.
- `one_force`: a force at one place, of whatever law; `forced_model`: a fitted model with one.
- `law`: what such a force says of what is attached there.
- `grid`: the nodes of the field: where it sits, how far it spreads, its mirror images.
- `field_model`: a fitted model with a field in it, and what each value of it does to the FRFs.
- `descent`: Gauss and Newton's steps, from smoothed spectra to sharp ones.
- `aside`: FRFs that no step sees, which choose among kinds and images.
- `strength`: how large and how smooth a field may be, by cross-validation over the FRFs.
- `told`: what was found, in words and numbers.
"""

from torchplate.diagnosis.field.infer import force_alone, infer_field, with_field

__all__ = ["force_alone", "infer_field", "with_field"]
