"""Identification of the columns of logs by names and by numbers, and nominal units and scales of sensors."""
