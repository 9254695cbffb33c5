"""What the world is made of: builders that return `mujoco.MjSpec`, masks, optics data, and trained weights."""
