"""The folder that an embedded user ships: a block as C with its own test, firmware, and boards to run it on."""
