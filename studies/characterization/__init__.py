"""Measures the stripes' contrast against distance."""
