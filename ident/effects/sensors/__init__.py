"""Effects of sensors and their mounting."""
