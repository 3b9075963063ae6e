"""Export of autopilots, vehicles and closed loops: as C code with a test, as an FMU, and as a WebAssembly page."""
