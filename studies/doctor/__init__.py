"""Whether a machine can run everything, and how fast."""
