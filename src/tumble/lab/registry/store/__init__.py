"""Everything that the registry asks of a database, SQLite or PostgreSQL.

connect   where the registry is; transactions of readers and writers
tables    the tables, and which version of them a database has
rows      records, files, limits and forecasts, within a transaction of the caller's
"""
