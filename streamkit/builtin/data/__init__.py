"""Data that do not come from a stream: of the host, and of the remnant of a progenitor."""
