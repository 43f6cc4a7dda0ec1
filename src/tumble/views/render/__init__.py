"""Blocks on a terminal, as HTML, as PDF, in a notebook; results as JSON; pictures as files."""
