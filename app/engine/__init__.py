"""Executes work: pixels in threads and child processes, jobs one after the other, and
chunks of jobs in this process or on other machines."""
