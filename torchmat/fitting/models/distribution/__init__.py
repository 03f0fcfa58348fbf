"""The fit of the distribution material."""
