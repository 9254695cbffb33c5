"""Recorders: Rerun, logs, and the base class of both."""
