"""Effects of wind, waves, current and what hangs in the water."""
