"""The renderer, windows and training batches in torch, for a GPU."""
