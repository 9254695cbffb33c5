"""When things happen in the loop: a model for every stage, what became of each frame and command, and by when."""
