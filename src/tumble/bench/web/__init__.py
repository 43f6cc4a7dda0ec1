"""The server of the page, and who may command it."""
