"""Studies at work: what is to be done, by which processes, and the condensed results of it."""
