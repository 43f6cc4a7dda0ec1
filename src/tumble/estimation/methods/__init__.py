"""Methods of estimation, interchangeable: observations in, estimate out."""
