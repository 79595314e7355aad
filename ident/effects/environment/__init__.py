"""Effects of wind, waves, current, tethers and moorings."""
