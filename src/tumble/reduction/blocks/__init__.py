"""A log as blocks: their means, the state of its channels, and the samples kept for the turns."""
