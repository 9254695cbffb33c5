"""Wrappers for learning under delay, on Gymnasium's own; each keeps states, copies and pickles."""
