"""Which unit, scale, rate and sign a recording is in: guesses, each tried on the recording itself, which is read once.
`rests_and_turns`: what rests and turns show; `trials`: the candidates."""
