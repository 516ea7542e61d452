"""Training runs, evaluations, statistics."""
