"""The registry: devices, launches, calibrations and limits over years, in a file of SQLite or a PostgreSQL database.

Records are added and never changed; the database itself refuses updates and deletions.

    registry   the class `Registry`: what is added, listed, judged and learned
    records    records and limits as they are read back, and when a device is due
    trend      run to run, drift a year, as found against as left
    database   its tables, where it is, transactions of readers and writers
    views      what is shown of it

Needs the extra `tumble[lab]`.
"""
