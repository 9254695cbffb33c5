"""A surface in, robot commands out. Would run on the real arm unchanged; never imports MuJoCo or torch."""
