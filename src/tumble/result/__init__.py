"""From a session to a calibration, and what is done with one: launches, comparison, verification, application."""
