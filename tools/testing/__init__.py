"""What stands behind the fixtures of the pytest plugin (`tonus.pytest_plugin`): a lab, whole runs
and a daemon for one test each."""
