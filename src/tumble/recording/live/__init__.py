"""Rows of numbers as they are received: files that grow, standard input, network, serial lines and MAVLink."""
