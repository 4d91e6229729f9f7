"""What an emulated drive does by CiA 402, whoever made it: states, modes, limits, inputs."""
