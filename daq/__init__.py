"""Data acquisition: device bytes are decoded to samples and written to an MCAP log; logs are read as arrays."""
