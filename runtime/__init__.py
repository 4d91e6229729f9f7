"""What the robot does each millisecond, and the daemon round it.

The tick is `cycle.ControlCycle.step`, a pure function; everything else here feeds it, paces it or
records it. This room knows `config` and `drivers`, and cannot tell the lab from the real robot.
"""
