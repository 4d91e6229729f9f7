"""The lab's EtherCAT: slave controllers that process real frames, and the doors to them.

A device of `tonus.sim.devices` knows nothing of this room; a `Slave` here gives it a controller, a
mailbox and distributed clocks, and a `Segment` chains the slaves. Only `port` and `veth` touch the
host.
Sources: ETG.1000 parts 4 to 6 and the public data sheets of slave controllers, as told in
docs/ethercat.md.
"""
