"""The registry: devices, launches, calibrations and limits over years.

An SQLite file, or a PostgreSQL database by its URL; the same code. Records are added and never changed: a correction is
a record of its own that supersedes another, and the database itself refuses updates and deletions.

    types      records, limits and forecasts as they are read back
    store      all that is asked of the database: transactions, tables, rows
    adding     a calibration file as something to add; adding calibrations, and limits of device types
    series     each parameter over the calibrations of a device, in one frame; verdicts; launches of a device or type
    trend      run to run, drift a year, as found against as left; when a drift meets a limit
    monitor    the history of a device against the limits that are in force
    due        the records of a device; when which device is to be calibrated again
    exchange   export and import as JSON lines

Needs the extra `tumble[lab]`.
"""
