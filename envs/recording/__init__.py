"""Recorders: Rerun, logs, and the protocol that both follow."""
