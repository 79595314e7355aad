"""Workflows of the `seatrial ident` commands.

A module contains the options of one command and its sequence of steps, from logs to result files. The numerical work is
in other packages, such as estimation and characterisation. The options of the command line are in cli.
"""
