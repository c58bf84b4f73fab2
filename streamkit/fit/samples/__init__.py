"""The samples of a run, with intervals, masses and predictions."""
