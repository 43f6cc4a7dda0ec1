"""What is wrong with a recording or an estimate, said in sentences with cause and remedy.

Of a recording, before anything is estimated: `channels`, `accelerometer_unit`, `carried_vertical` with
`exchanged_columns`, and `upside_down`. Of an estimate: `undetermined`, `site_gravity` and `misfit`, of which `verdict`
makes an outcome.
"""
