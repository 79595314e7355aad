"""Explain: arrays to models, residuals, effects and reports, and the design of the next experiment."""
