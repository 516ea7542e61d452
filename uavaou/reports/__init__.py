"""Pictures and text: figures, trajectories, audits. Reads data, never trains."""
