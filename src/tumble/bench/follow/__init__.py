"""From the log on disk to the rests, what is wrong with them, and the estimate so far."""
