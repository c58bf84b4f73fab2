"""Data that do not come from a stream: of the host, and of what is left of a progenitor."""
