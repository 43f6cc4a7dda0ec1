"""Text logs that are no table of numbers: a function a dialect, and the table of them in `respelled`."""
