"""The staged method: accelerometers first, then gyros."""
