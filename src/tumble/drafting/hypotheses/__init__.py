"""Which unit, scale, rate and sign a recording is in: guesses, each tried on the recording itself.

`readings` looks at numbers one by one, `rests_and_turns` at what rests and turns show, `trials` tries the candidates:
accelerometers at rest read gravity, gyros carry the vertical from rest to rest. The log is read once for all.
"""
