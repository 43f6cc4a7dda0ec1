"""Recording of a source into the log on disk."""
