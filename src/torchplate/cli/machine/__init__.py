"""What a command runs on.

- `device`: where its tensors live.
- `allocator`: what becomes of memory that is freed.
- `ranks`: the processes of torchrun that share the search of a run.
"""
