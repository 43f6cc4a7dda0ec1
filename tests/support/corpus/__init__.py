"""Small text logs in the dialects and with the blemishes of the world, all of one simulated session."""
