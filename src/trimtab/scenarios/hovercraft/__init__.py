"""The hovercraft's flights, with the settings of the source's tables."""
