"""Pictures and pages made from a log."""
