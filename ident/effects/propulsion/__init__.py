"""Effects of thrusters and propellers on a boat."""
