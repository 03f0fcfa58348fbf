"""Tiles: stub."""

def fit_tiled(training, model, options, geometry, tile, memory_mb, work):
    raise NotImplementedError
