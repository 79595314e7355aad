"""seatrial: measure a boat and its thrusters, excite them with designed inputs, and explain what was measured."""
