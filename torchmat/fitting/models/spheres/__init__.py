"""Fits of sphere images, to a BTF and to a measured BRDF."""
