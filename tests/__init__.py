"""Tests, in folders as `src/tumble` is; what they share is in `support`."""
