"""What can be said of a measurement before a model is fitted to it.

- `quality`: driving points, reciprocity, coherence, noise between lines, peaks, suspicious channels.
- `noise`: how noisy each line is, from the measurement alone; `regression`: its two components, from what is left.
- `rational_fit`: FRFs as rational functions with common poles, and what they leave; `outliers`: the fit without poles
  that stand for a line or two alone; `resonances`: its poles and residues, between the lines and beside the axis too.
- `plausibility`: whether a model and a measurement can belong together: frequencies, kind and level.
"""
