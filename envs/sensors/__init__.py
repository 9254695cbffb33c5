"""Ray-cast sensors: the stripe camera and what it is made of."""
