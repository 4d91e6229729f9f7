"""Its place puts this folder on the import path: `loop` and `statue` serve tests of every kind."""
