"""Noise of single sensors over averaging time, noise of the means of rests, and the effect of rounding."""
