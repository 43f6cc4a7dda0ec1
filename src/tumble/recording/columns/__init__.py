"""Columns of logs: what they are by their names and by their numbers, and the units and scales of sensors."""
