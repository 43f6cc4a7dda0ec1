"""Turns from rest to rest: integrals over their samples, and what these say of parameters."""
