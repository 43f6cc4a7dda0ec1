"""Maximum likelihood over everything a session contains, and over what the model does not know about itself."""
