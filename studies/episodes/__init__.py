"""Runs many episodes, and tells them in tables and figures."""
