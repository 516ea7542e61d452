"""Experiments: jobs, who performs them, and the lists of jobs that studies, suites and searches are."""
