"""Methods of estimation beside the default one, interchangeable: observations in, estimate out."""
