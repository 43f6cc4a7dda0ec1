"""Likelihood of a session, the maximum of the posterior of its hyperparameters, and the integral over them."""
