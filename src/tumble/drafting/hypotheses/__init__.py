"""Which unit, scale, rate and sign a recording is in: guesses, each tried on the recording itself, which is read once.
`cost`: what rests and turns show, and what every hypothesis costs; `weighed`: what a draft becomes by the best."""
