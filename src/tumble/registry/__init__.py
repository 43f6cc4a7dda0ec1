"""The registry: devices, launches, calibrations and limits over years.

An SQLite file, or a PostgreSQL database by its URL; the same code. Records are added and never changed: a correction is
a record of its own that supersedes another, and the database itself refuses updates and deletions.

    connect    where the registry is; transactions of readers and writers
    schema     the tables, and bringing an older database up to date (migrations/)
    records    a calibration file as a record, and records as they are read back
    store      add, list, show; limits of device types
    limits     acceptance limits and verdicts
    series     each parameter over the calibrations of a device, in one frame
    trend      run to run, drift a year, as found against as left
    due        when which device is to be calibrated again
    exchange   export and import as JSON lines
    tables     all of it on a terminal
    chart      control charts as HTML and SVG

Needs the extra `tumble[registry]`; charts need `tumble[report]`.
"""
