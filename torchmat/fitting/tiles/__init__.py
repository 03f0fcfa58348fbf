"""Fits tile by tile, in bounded memory."""
