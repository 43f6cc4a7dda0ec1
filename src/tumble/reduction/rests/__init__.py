"""Rests: found in a log, matched to a programme, and their mean readings with covariance."""
