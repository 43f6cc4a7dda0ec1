"""The commands, one file each: a command parses, calls one function and prints."""
