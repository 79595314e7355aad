"""Command line of `seatrial ident` and `seatrial mission design`: arguments, options and progress display. The steps of
each command are in workflows.
"""
