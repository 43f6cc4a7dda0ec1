"""Methods of calibration: one file, one method, one function from Observations to an Estimate."""
