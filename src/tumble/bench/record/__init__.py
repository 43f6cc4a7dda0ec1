"""From a source to the log on disk."""
