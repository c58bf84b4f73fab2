"""Checks of a posterior, each with its rule and the source of the rule."""
