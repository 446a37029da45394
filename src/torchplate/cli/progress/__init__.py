"""What a run tells while it goes on.

- `console`: where a verb speaks, in lines that are not cut where they are piped.
- `bar`: a search that shows how far it is; `heartbeat`: a line every ten seconds where no bar can be shown.
- `log`: TensorBoard, the history and the checkpoints (the only file with tensorboard).
- `layout`: which of it TensorBoard lays over what on a chart.
"""
