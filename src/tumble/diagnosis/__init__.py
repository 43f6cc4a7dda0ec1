"""What is wrong with a recording or an estimate, said in sentences with cause and remedy.

Of a recording, before anything is estimated: `channels`, `carried_vertical` by `turn_likelihood`. Of an estimate:
`undetermined`, `site_gravity` and `misfit` with the table of `causes`, of which `verdict` makes an outcome.
"""
