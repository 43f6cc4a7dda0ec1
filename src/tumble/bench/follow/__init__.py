"""From the log on disk to its rests, its faults and the estimate so far."""
