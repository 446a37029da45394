"""Virtual hammer tests: a measurement from a model.

- `analyser`: the two-channel analyser; `hammer_test`: the test with it; `simulation`: the same of a plate without its
  mesh error (`simulate`).
"""
