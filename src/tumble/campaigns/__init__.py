"""Many calibrations, simulated or recorded, on one machine or a cluster."""
