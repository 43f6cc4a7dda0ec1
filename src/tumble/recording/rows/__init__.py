"""Rows of logs: their times, and the samples that are lost between them."""
