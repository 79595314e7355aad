"""Effects of the hull: resistance, damping, couplings."""
