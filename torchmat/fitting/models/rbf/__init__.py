"""The fit of `rbf`: principal images in one colour, and splines through their weights."""
