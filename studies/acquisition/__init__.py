"""Collects stripe frames paired with a reference camera's depth."""
