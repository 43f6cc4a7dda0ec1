"""From a log or recording as it comes to a session: which columns are sensors, their units, rates, scales and times."""
