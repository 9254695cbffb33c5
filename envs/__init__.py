"""The theatre: scene composition, ray-cast sensors, clocks and delays, tasks, the Gymnasium face, the recorder."""
