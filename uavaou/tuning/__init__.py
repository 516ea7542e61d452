"""Hyperparameter search: what is searched, its trials, and its results."""
