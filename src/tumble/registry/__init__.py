"""The registry: devices, launches, calibrations and limits over years.

An SQLite file, or a PostgreSQL database by its URL; the same code. Records are added and never changed: a correction is
a record of its own that supersedes another, and the database itself refuses updates and deletions.

    types           records, limits and forecasts as they are read back
    store           all that is asked of the database: transactions, tables, rows
    submission      a calibration file as something to add
    adding          adding calibrations, and limits of device types
    records         the records of a device
    series          each parameter over the calibrations of a device, in one frame; the verdict on a record
    trend           run to run, drift a year, as found against as left
    forecast        when a drift meets a limit
    monitor         the history of a device against the limits that are in force
    due             when which device is to be calibrated again
    type_launches   how unstable devices of a type are from power-on to power-on
    exchange        export and import as JSON lines

Needs the extra `tumble[registry]`.
"""
