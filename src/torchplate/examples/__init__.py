"""The FRF embedded in torch: files to copy from, each run by `python -m torchplate.examples.NAME`.

- `parameter_network`: a network from FRFs to parameters, trained through the FRF instead of on parameters alone.
- `thickness_field`: a thickness for each element by L-BFGS, the gradient of all of them by one reverse pass.
- `sensor_placement`: sensor places that make the parameters' standard errors small, by gradient in the places.

Nothing else in torchplate imports them.
"""
