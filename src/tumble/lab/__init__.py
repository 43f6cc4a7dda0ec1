"""The laboratory: what keeps, judges and certifies calibrations. It comes into tumble by entry points alone.

limits, conformity    acceptance limits of a type; the decision rule, and the verdict on every parameter
registry              devices, calibrations and limits over years: trends, and what is due
device_type           what the units of a type have in common, as a prior for the next one; datasheet shows it
certificate           who calibrated what for whom
report, dcc           reports by limits and certificates; the Digital Calibration Certificate
selftest              reference cases on the user's machine, and a record of them
"""

from __future__ import annotations

from tumble.lazy import names_of

__all__, __getattr__ = names_of(__name__, __file__)
