"""Turns from rest to rest: integrals over their samples, and the sensitivities of these to parameters."""
