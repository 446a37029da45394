"""YAML in, `runs/` out: the command `torchplate`.

- `config`: the YAML file and its errors (the only file with yaml and pydantic).
- `build`: from a config to model, evidence and optimiser.
- `run`, `compare`, `simulate`, `inspect`, `diagnose`: the verbs.
- `population`, `ranks`: the search of a run as one job; the processes of torchrun that share it.
- `basis`: the basis a run searches in, confirmed at the best member.
- `folder`: where a run is written and what it is resumed from.
- `result`, `report`, `figures`, `log`: result.json, report.md, the figures, and what goes to TensorBoard as it happens.
- `diagnosis_report`, `diagnosis_figures`, `assurance_figure`, `diagnosis_style`: what a diagnosis says to people.
- `main_job`, `hidden_effect`, `paper`, `real`: what `make run`, `make diagnose`, `make paper` and `make real` do.
- `bench`: `torchplate bench`, what is fast and beside what.
- `main`: the command line.
"""
