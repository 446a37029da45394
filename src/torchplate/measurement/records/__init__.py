"""Time records of hits, and FRFs, in files that name no nodes: from them to one measurement.

- `recording`: time records of hits, cut and checked; `tables`: tables of channels from WAV, MAT, NPZ, CSV and LVM
  files; `readers`: records from files of any kind, with the nodes that belong to them.
- `estimate`: FRFs and coherence from cut hits; `whole_test`: recordings of a whole test as one measurement.
- `frf_tables`: FRFs from MAT, NPZ, CSV and text.
"""
