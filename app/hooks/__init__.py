"""Hooks: signed requests to other servers when a job or a review has ended."""
