"""The live page: a recording followed as it grows, what to do next, and the calibration at the end."""
