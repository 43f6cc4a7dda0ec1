"""Calibrations: their parts, file, frames, uncertainty and correction of readings."""
