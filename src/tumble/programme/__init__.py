"""Programmes: positions and turns, and the operator's sheet."""
