"""Experiments: jobs, who performs them, the table of flights, and the lists of jobs that studies, suites and searches are."""
