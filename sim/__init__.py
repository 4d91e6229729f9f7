"""The lab in software: buses, emulated devices and the robot's dynamics behind them.

It is written against the configuration and the public standards only, apart from the controller, so
that one mistake cannot hide in both.
"""
