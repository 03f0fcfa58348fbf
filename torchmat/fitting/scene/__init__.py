"""Fits of what a scene uses."""
