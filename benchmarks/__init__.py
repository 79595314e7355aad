"""Speed, accuracy and loss of seatrial on this machine, beside what others reach: ``python -m benchmarks``."""
