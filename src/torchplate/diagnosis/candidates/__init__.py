"""What may be missing.

- `catalogue`: every effect of the catalogue, as one or several candidates.
- `candidate`: what one of them is; `trials`: the places, sizes and values at which it is tried; `images`: places that
  a plate turned over has.
- `channels`: which channels may be exchanged or turned.
- `held_edges`: edges on springs that may yield.
- `supports`: what is grounded at a place, taken for a support.
"""
