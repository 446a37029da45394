"""A plate's receptances: its modes, the sum over them, what is attached at places, and the derivatives of all of it.

- `modes`: batched natural frequencies and mode shapes; `modes_at`: both at places of the plate, differentiable.
- `modal_receptance`: a plate in modal coordinates, and its receptances by modal sum, exact for local dashpots;
  `complex_modes`: where a part of it has a loss of its own.
- `frf`: what a sensor chain makes of receptances, and the direct solve that referees them; `batched`: below both.
- `modal_solution`: the solve of one batch by the modes of each member.
- `rearranged`: FRFs that an effect only exchanges or turns.
- `gradient`: their derivatives, exact where natural frequencies repeat too; `impedance`, `loewner`: below them.
- `modal_sum`: the sum over modes for many lines at once; `attach`: springs, dashpots and masses attached to it.
- `shared_modes`: plates that differ by a factor have the same modes, and need no eigenproblem at all; `attached_sum`:
  their modal sums, values in place and gradients by the adjoint.
"""
