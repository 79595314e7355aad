"""Preflight: `seatrial check` of a rig, a mission and the actuators."""
