"""The supervisor: judges the daemon from the bus frames, its record and the configuration alone,
and stops the robot by silence. No code of the control path, no estimator, no compiled code.

`supervisor` looks and decides, in this order: `listener` reads the frames that `watched` names,
`record` the daemon's records (`recorded` where no frames are read); `observation` makes one view of
both, `devices` says which drives have power; `changes`, `commands` and `judge` find what is wrong;
`voice` sends the heartbeat, or no more."""
