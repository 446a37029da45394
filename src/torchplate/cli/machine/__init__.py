"""What a command runs on.

- `device`: where its tensors live.
- `ranks`: the processes of torchrun that share the search of a run.
"""
