"""The joint method: everything a session contains in one likelihood."""
