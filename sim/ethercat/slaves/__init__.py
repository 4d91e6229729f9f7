"""An emulated EtherCAT slave: controller, EEPROM, mailbox, states and clock (ETG.1000)."""
