"""Data acquisition: device bytes to samples to an MCAP log, and logs to arrays."""
