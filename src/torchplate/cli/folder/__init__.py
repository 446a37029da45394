"""The folder that a command writes.

- `opening`: where it is, what is written there first and never over, and what a run is resumed from.
- `occupied`: by one command at a time.
- `writing`: files that are written whole or not at all.
- `checkpoint`: whether a search can go on from a file; `descents`: what a diagnosis goes on from.
"""
