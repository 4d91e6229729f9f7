"""From the record of a tick to MCAP files: rings, encoders, the recorder, keyframes."""
