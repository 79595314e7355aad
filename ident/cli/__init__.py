"""The commands of `seatrial ident` and `seatrial mission design`."""
