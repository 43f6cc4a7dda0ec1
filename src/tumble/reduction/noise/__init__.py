"""Noise: of single sensors over averaging time, of the means of rests, and what rounding does."""
