"""Command line of `seatrial ident` and `seatrial mission design`: arguments and options. The steps are in workflows."""
