"""The fit of the microfacet material."""
