"""Ways to run a trained depth network fast: torch as it is, compiled, on a GPU, or another runtime."""
