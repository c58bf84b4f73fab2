"""Calls of the posterior: one at a time, on worker processes, and the search for a start."""
