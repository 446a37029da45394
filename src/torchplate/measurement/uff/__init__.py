"""Universal files, read and written.

- `dataset`: a file dataset by dataset: 58 (ASCII, binary), 164; `values`: those of a dataset 58, in each of the eight
  cases of the format.
- `coordinate_system`: those of datasets 18 and 2420, and the way from them to the global one; `geometry`: units (164)
  and nodes (15 or 2411).
- `frfs`: FRFs and coherence as one measurement; `modes`: a modal model, from 55 and 2414, and written as 55.
- `contents`: what a file holds, and what can be done with it.
- `writer`: a measurement written as a universal file.
"""
