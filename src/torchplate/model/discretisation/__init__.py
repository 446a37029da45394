"""How many dofs a plate has: a finer mesh, the error of the given one taken off, a small basis, and what each leaves.

- `fine_mesh`: one member in sparse matrices, where dense ones would be too large; `direct_solves`: with these.
- `extrapolation`: the mesh error taken off, from a mesh twice as fine; `retaken`: off another plate of the box.
- `reduced_basis`: a small basis for the whole box of the searched parameters.
- `error_estimate`: how wrong it is, measured or estimated, member by member.
"""
