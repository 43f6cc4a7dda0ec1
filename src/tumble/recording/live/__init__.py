"""Rows of numbers as they come: files that grow, standard input, network, serial lines and MAVLink."""
