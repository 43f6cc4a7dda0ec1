"""Likelihood of a session, its joint maximum, and the posterior integrated over the hyperparameters."""
