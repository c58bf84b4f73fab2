"""The samples of a run, and what follows from them: intervals, masses, predictions."""
