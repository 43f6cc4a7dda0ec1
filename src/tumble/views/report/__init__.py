"""Reports: calibrations as one page of HTML that needs no other file and prints well.

Needs the extra `tumble[lab]`. Limits and certificates are added by `tumble.lab.report`.
"""
