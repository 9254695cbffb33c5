"""Data sets of episodes in which a scripted controller shows how a task is done."""
