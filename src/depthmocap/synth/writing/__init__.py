"""Samples in bulk: streams, data sets on disk, data cards, clusters."""
