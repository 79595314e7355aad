"""The work of one command each, from logs to results."""
