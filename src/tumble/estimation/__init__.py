"""From observations to an estimate: likelihood, methods, diagnosis, observability."""
