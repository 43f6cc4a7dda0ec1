"""Simulated sessions by physics of their own: nothing of tumble is imported here.

    motion.py    where the device is and how it is turned, as functions of time, and what sensors in it feel
    waving.py    the same of a device that never lies still, or always
    device.py    sensors drawn at random: what they read, what their biases do in time, temperature
    driver.py    what happens between a sensor and the file: filters of software, lost rows, clocks, units
    kinds.py     the table of kinds, and `simulated(kind, index)`, one session

Frames: n has the axes north, up, east; the body frame b is that of the accelerometers. Units are SI and radians.
"""
