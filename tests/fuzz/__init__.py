"""Random, mutated and out-of-order frames against whatever has to stay standing."""
