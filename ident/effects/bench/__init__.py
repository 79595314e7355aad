"""Effects of a thruster on the bench: shaft, thrust, load cell, test basin."""
