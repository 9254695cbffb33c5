"""The scenes that studies share."""
