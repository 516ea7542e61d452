"""The learners, one folder an algorithm."""
