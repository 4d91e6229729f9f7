"""The `tonus` command line, logs, reports: the one room that may put all the others together."""
