"""Four studies of a run file. None imports another."""
