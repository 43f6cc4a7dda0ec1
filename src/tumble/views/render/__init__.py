"""Rendering of blocks: terminal, HTML, PDF, pictures."""
