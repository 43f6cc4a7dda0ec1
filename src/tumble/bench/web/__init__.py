"""Server of the page, and access to it."""
