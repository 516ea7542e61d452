"""A policy in command of one aircraft: goes where the policy says, and comes home. On the exported policy alone."""
