"""The directory of a run: who may write there, its manifest, and whether its files are as they were written."""
