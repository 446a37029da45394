"""Where the points of a test lie, in its file and on the plate.

- `frame`: where the plate lies in the file's coordinates; `placement`: where each channel sits on the plate.
- `nodes`: a table of coordinates, for files without any; `heads`: the unit of length that the head of such a table
  states.
- `proposal`: sides, axes and unit of the plate, proposed from the points of a test.
"""
