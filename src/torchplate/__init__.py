"""torchplate: model updating of plates from measured vibration, as batched torch tensors."""
