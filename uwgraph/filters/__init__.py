"""Filters beside the graph, on the same measurement models: unscented, adaptive, extended, with smoothing pass."""
