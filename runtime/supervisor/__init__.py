"""The supervisor: judges the daemon from the bus frames, its record and the configuration alone,
and stops the robot by silence. No code of the control path, no estimator, no compiled code."""
