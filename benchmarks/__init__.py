"""Benchmarks of seatrial on this machine, compared with other programs: ``python -m benchmarks``.

They measure the speed of estimation and codecs, the accuracy of estimates, and the loss of samples in acquisition.
"""
