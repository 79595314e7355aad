"""Workflows of the ident commands: the options and the sequence of steps of each, from logs to result files.

They read and check the logs, choose model and input signals, call the packages below, and write model.toml, result.json
and report.html. The numerical work is in these packages, for example in estimation and characterisation. The options of
the command line are declared in cli.
"""
