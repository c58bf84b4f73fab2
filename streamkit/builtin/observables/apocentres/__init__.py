"""Apocentres of the leading and trailing arm, and the angle between them (Gibbons+ 2014)."""
