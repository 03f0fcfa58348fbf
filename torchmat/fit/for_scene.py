"""Scene: stub."""

def fit_for_scene(training, config, options, geometry, scene):
    raise NotImplementedError
