"""The tasks as learners want them: normalised spaces, a frame a decision, rewards of order one an episode."""
