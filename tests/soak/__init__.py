"""Half an hour of the robot's life in virtual time (`make soak`)."""
