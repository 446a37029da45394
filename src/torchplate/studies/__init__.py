"""What the project shows of itself: whole studies, each a command that writes its folder below `runs/`.

- `main_job`: a virtual test and measured natural frequencies, each identified by two searches (`make run`).
- `hidden_effect`: a magnet that nobody wrote down, found (`make diagnose`).
- `paper`: the paper's tables and figures again, twenty seeds (`make paper`).
- `real`: plates that others have measured (`make real`).
- `masses`: what was lightened on a measured strip with masses, state by state.
- `moduli`: what air and a sensor do to the moduli of the measured spruce plates.
- `gaps`: what each effect that is known to be there takes off the gap of these.
- `load`: time and memory of large work, each against what it is to keep to (`make load`).
- `chairs`: from three kinds of files to an answer, with a stopwatch (`make chairs`).

`python -m torchplate.studies.NAME` runs one. They stand above every other room, and none is imported by another room.
"""
