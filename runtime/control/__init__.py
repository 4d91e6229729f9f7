"""From the process image to torques: each stage of the tick, a function with its own state."""
