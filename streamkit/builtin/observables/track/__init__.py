"""The mean track of a stream on the sky, in any of its columns, and its member stars."""
