"""A recording read: the session file, the log it names, formats, gaps."""
