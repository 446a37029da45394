"""Modal models: natural frequencies, damping and mode shapes at points.

- `model`: the model (`ModalModel`), and its table.
- `analysis`: the same estimated from FRFs.
"""
