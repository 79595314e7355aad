"""Tables and figures of the paper, made again from simulated data with known truth: ``python -m benchmarks.thesis``."""
