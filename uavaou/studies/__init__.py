"""Studies: many trainings and the planners beside them, resumable, with condensed results."""
