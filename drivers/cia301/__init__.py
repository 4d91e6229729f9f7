"""The object dictionary as CAN and EtherCAT share it: settings, PDO mappings, abort codes."""
