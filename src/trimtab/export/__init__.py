"""Export of autopilots, vehicles and closed loops: as C with its own test, as an FMU, and as a WebAssembly page."""
