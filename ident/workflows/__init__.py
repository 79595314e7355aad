"""Workflows of the ident commands, from logs to results: one module for each command."""
