"""The choice among models: what is tried, how it is judged, and the smallest that does."""
