"""Arrays and text of a file, whoever wrote it.

- `archive`: those of an .npz archive, and text of a header.
- `text_table`: cells, units and numbers of a table that is text.
- `mat_elements`: what a MAT file holds, walked before SciPy reads it.
- `parsing`: what a broken file raises becomes one sentence.
"""
