"""Policies on missions: what they reach, and an independent check of the constraints."""
