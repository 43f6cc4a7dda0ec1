"""Causes of residuals that the noise does not explain, each tested where the estimate stands.

`ranking` tests all of them: what goes with time (`over_time`), with former attitudes, with force and rate beyond the
model (`nonlinearity`), with the place (`latitude`), and with the samples (`quantisation`, `lost_samples`).
"""
