"""Measures depth estimators on held-out tissues."""
