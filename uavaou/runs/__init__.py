"""One training on disk: its folder, its records, its checkpoints, and the trained policy."""
