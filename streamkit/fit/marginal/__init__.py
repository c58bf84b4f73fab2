"""The likelihood of a stream as a function of its host alone: the integral over the stream's own parameters."""
