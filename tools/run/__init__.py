"""One run from its order to its summary, with the processes it takes."""
