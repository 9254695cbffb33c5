"""Turns committed results into pages."""
