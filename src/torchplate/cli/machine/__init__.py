"""What a command runs on.

- `device`: where its tensors live.
- `installed`: what is installed, by name and version.
- `allocator`: what becomes of memory that is freed.
- `ranks`: the processes of torchrun that share the search of a run.
"""
