"""Text files of logs: their encoding, dialect, pieces and values."""
