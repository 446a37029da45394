"""What may be missing.

- `candidate`: every effect of the catalogue, with its options, places and sizes to try.
- `channels`: which channels may be exchanged or turned.
- `held_edges`: edges on springs that may yield.
- `supports`: what is grounded at a place, taken for a support.
"""
