"""The EtherCAT fieldbus: one class on two wires.

`EthercatFieldbus` knows slaves, states and process data. What carries them is a `Wire`: the SOEM
master through pysoem on a network interface, or a small deterministic master whose frames go
through a function, for virtual time.
"""
