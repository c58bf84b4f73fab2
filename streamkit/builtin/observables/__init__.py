"""Measurements of a stream that are compared with data."""
