"""Workflows of the ident commands: options and sequence of steps of each, from logs to files and the answer. The
numerical work is in the packages below, such as estimation and characterisation; the options of the command line are in
cli.
"""
