"""Evaluation suites: one scenario changed point by point, and who flies each point."""
