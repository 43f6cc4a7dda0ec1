"""Reading of recordings: the session file, its log, formats, gaps."""
