"""The tables of session.toml, a module for each, and what is said where one of them is not as it should be.

Each key's `description` says what is expected of it, and every message is made from it: "session.toml:
site.latitude_deg: expected a number from -90 to 90, found 145.5". What concerns several keys at once is checked by the
validators of the tables. `document` is the whole file, `faults` makes the messages.
"""
