"""YAML in, `runs/` out: the command `torchplate`.

- `config`: the YAML file and its errors (the only file with yaml); `schema`: what it may hold, key by key (the only one
  with pydantic); `reference`, `catalogue`: the same for people, and the catalogue of effects.
- `recipe`: a checked config and the plate it describes; `measured`: with what was measured; `searches`: and the search;
  `build`: from all of these to model, evidence and objective; `memory`: whether its mesh fits the machine.
- `new`, `draft`, `new_text`: from a measurement file to a commented config, what is guessed for it, and its words.
- `frf`: from time records of hits to FRFs; `modes`: from FRFs to a modal model.
- `run`, `compare`, `simulate`, `inspect`, `diagnose`: the verbs; `run_states`, `diagnose_change`: of several tests.
- `progress`: a search that shows how far it is; `found`: what a run ends with; `device`: where its tensors live.
- `plate_test`: a config as a test that a diagnosis or a plan takes.
- `finished`: finished runs below a folder, and which plate each is of; `gathered`: their searches put together.
- `plan`, `plan_text`: the verb that says what to measure next, and its words.
- `ranks`: the processes of torchrun that share the search of a run.
- `folder`: where a run is written and what it is resumed from; `occupied`: by one command at a time; `writing`: files
  that are written whole or not at all; `descents`: what a diagnosis goes on from;
  `checkpoint`: whether a search can go on from a file.
- `log`: what goes to TensorBoard as it happens; `layout`: which of it lies over what on a chart; `heartbeat`: a line
  every ten seconds where no bar can be shown.
- `bench`: `torchplate bench`, what is fast and beside what.
- `main`: the command line; `verbs`: all verbs; `verb`: what one is; `file_verbs`, `run_verbs`, `telling_verbs`: what
  each takes, an example of it, and what it calls.
"""
