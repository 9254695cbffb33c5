"""Renders the frames that networks learn from, with exact depth."""
