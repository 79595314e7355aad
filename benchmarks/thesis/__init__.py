"""The paper's tables and figures once more, on simulated data whose truth is known: ``python -m benchmarks.thesis``."""
