"""The CANopen master: SDO client, NMT and heartbeat, PDO configuration, EMCY, and the fieldbus
that joins them over any python-can interface."""
