"""The registry of devices, calibrations and acceptance limits, in an SQLite file or a PostgreSQL database.

Records are only added; the database itself refuses updates and deletions. Needs the extra `tumble[lab]`.
"""
