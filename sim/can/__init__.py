"""The lab's CAN: frames of true length, timed channels, CANopen nodes, and the doors to them.

A device of `tonus.sim.devices` knows nothing of this room; a `Node` here gives it a bus.
"""
