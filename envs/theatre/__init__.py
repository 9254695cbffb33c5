"""The physics: scene, arms, tissue, trocars, actuation, organ motion."""
