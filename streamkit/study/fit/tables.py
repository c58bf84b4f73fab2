"""The tables of a fit."""

from __future__ import annotations

LEVELS = {"lo95": 2.5, "lo68": 16.0, "median": 50.0, "hi68": 84.0, "hi95": 97.5}
"""Percentiles in tables and pictures: the median with its central 68 % and 95 % intervals."""
