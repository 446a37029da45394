"""The figures of reports.

- `style`: colours, curves and axes that all of them share; `drawing`: a figure as a picture.
- `gap`, `bands`, `frf`, `plate_map`, `field_map`, `assurance`, `quality`: what each of them shows.
- `mode_shapes`: small multiples of a model's modes; `measured_shapes`: what was measured beside them.
- `shape_agreement`: MAC and COMAC of shapes that were measured as such; `modal_fdac`: the shapes between their
  resonances; `paired_shapes`: both with the model's beside them.
"""
