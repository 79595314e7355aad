"""Entry point of `python -m seatrial`, which runs the command line."""

from seatrial.command_line import main

main()
