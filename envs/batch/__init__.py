"""Many environments at once: their physics in one call, a share of them in each of a few processes."""
