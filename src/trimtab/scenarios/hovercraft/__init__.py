"""Scenarios of the hovercraft, most of them with the settings in the tables of the thesis (Kulis 2006)."""
