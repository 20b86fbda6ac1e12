"""Executes work: on pixels, of jobs, and of their chunks.

Pixels are read in threads and child processes, jobs run one after the other, and chunks
of jobs in this process or on other machines.
"""
