"""Acceptance: whether a calibration is within the limits of its device type, and what a certificate states of that.

limits       the file of limits of a type, and when its devices are due
conformity   the decision rule; the verdict on every parameter, at the reference or over temperature
scope        what a laboratory is accredited for, and no U below its capability
certificate  who calibrated what for whom, when, and by which limits it is judged
"""
