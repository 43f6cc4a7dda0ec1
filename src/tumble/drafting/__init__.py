"""Drafts of sessions for logs of unknown form: columns of sensors, their units, rates, scales and times."""
