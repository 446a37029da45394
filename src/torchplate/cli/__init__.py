"""YAML in, `runs/` out: the command `torchplate`.

`main` starts it. Each folder uses itself and those listed before it:

- `schema`: what a config may hold, key by key (the only files with pydantic).
- `config`: from the YAML file to the model, the evidence and the search that it asks for (the only file with yaml).
- `machine`: what a command runs on: the device, and the processes of torchrun.
- `folder`: where a run is written and what it is resumed from.
- `progress`: what a run tells while it goes on: the bar, the lines, TensorBoard (the only file with tensorboard).
- `results`: what a run has ended with: written, found again, and put together over runs.
- `verbs`: what each verb does; `torchplate diagnose` is `verbs/diagnose`.
- `arguments`: what each verb takes on the command line, an example of it, and what it calls.
"""
